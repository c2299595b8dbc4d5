"""FRFs with known modes: a chain of four masses on springs, close modes from two references, modes outside the band."""

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


APART, CLOSE, DAMPED = ([12.0, 18.0, 25.0, 33.0, 41.0], [20.0, 20.3, 25.0, 33.0, 41.0], [15.0, 22.0, 25.0, 33.0, 41.0])
LIGHT, MEDIUM, HEAVY = (
    [0.01, 0.01, 0.015, 0.01, 0.01],
    [0.015, 0.012, 0.015, 0.01, 0.01],
    [0.08, 0.12, 0.06, 0.1, 0.05],
)


def banded(
    seed, frequency=APART, damping=LIGHT, beyond=(0.5, 90.0, 160.0), noise=0.01, floor=0.0, inputs=(5, 2), lines=1000,
    known=False,
):  # fmt: skip
    """Accelerances of six points from 8 to 50 Hz, and the five mass-normalized shapes of the modes in it.

    Modes at `beyond` Hz, of a damping ratio of 2 %, are not. `noise` is a part of each value, `floor` of the largest of all.
    """
    n, five = 6, np.arange(1, 6)
    shapes = np.sin(five * np.pi * (np.arange(n)[:, None] + 0.7) / (n + 1.3))
    shapes[:, 1] = np.cos(1.3 * np.arange(n) + 0.5)
    all_shapes = np.concatenate([shapes, np.random.default_rng(7).standard_normal((n, len(beyond)))], axis=1)
    omega = 2 * np.pi * np.append(frequency, beyond)
    ratio = np.append(damping, np.full(len(beyond), 0.02))
    hertz = np.linspace(8.0, 50.0, lines)
    s = 2j * np.pi * hertz[:, None]
    modal = s**2 / (s**2 + 2 * ratio * omega * s + omega**2)
    values = np.einsum("or,ir,fr->foi", all_shapes, all_shapes[list(inputs)], modal)
    std = np.hypot(noise * np.abs(values), floor * np.abs(values).max())
    rng = np.random.default_rng(seed)
    values = values + std * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)) / np.sqrt(2)
    names = [f"{i + 1}X" for i in range(n)]
    variance = std**2 if known else None
    return FrfRecord(hertz, values, names, [names[i] for i in inputs], "accelerance", variance), shapes


def deviations(found, frequency, damping, shapes):
    """Errors of the modes nearest to the true ones over their standard deviations: frequency, damping, shapes."""
    near = np.abs(found.frequency[:, None] - frequency).argmin(axis=0)
    frequency_error = (found.frequency[near] - frequency) / found.frequency_std[near]
    damping_error = (found.damping_ratio[near] - damping) / found.std[found.n_modes :][near]
    shape_error = (aligned(found.mode_shapes[:, near], shapes).real - shapes) / found.shape_std[:, near]
    return frequency_error, damping_error, shape_error.ravel()


def aligned(shapes, truth):
    """`shapes` with the sign of `truth`, column by column."""
    return shapes * np.sign(np.sum(shapes.real * truth, axis=0))
