"""FRFs with known modes: a chain of four unequal masses on springs, and close modes seen from two references."""

import numpy as np
from scipy import linalg

from structid.records import FrfRecord

LINES = np.arange(0.0, 400.1, 0.5)
KINDS = ("receptance", "mobility", "accelerance")


def chain():
    """Frequencies in Hz and mass-normalized shapes in kg^-1/2."""
    stiffness = 1e6 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    stiffness[-1, -1] = 1e6
    values, shapes = linalg.eigh(stiffness, np.diag([1.0, 2.0, 1.5, 1.0]))
    return np.sqrt(values) / (2 * np.pi), shapes


def close_pair():
    """Two modes 0.2 % apart, a tenth of their half-power bandwidth, among the chain's."""
    frequency, shapes = chain()
    return np.insert(frequency, 2, frequency[1] * 1.002), np.insert(shapes, 2, [0.5, -0.2, 0.3, 0.7], axis=1)


def frf(
    frequency, shapes, inputs=(0,), kind="accelerance", damping=0.01, noise=0.0, seed=0, relative=False, known=True
):
    """FRFs of all rows of `shapes`.

    `noise` is a part of each FRF's rms, or of each value where `relative`; the record states it where `known`.
    """
    omega = 2 * np.pi * frequency
    s = 2j * np.pi * LINES[:, None]
    modal = s ** KINDS.index(kind) / (s**2 + 2 * damping * omega * s + omega**2)
    values = np.einsum("or,ir,fr->foi", shapes, shapes[list(inputs)], modal)
    size = np.abs(values) if relative else np.sqrt(np.mean(np.abs(values) ** 2, axis=0, keepdims=True))
    std = noise * np.broadcast_to(size, values.shape)
    rng = np.random.default_rng(seed)
    values = values + std * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)) / np.sqrt(2)
    names = [f"{i + 1}X" for i in range(len(shapes))]
    variance = std**2 if noise and known else None
    return FrfRecord(LINES, values, names, [names[i] for i in inputs], kind, variance)


def aligned(shapes, truth):
    """`shapes` with the sign of `truth`, column by column."""
    return shapes * np.sign(np.sum(shapes.real * truth, axis=0))
