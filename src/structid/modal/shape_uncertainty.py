"""Standard deviations of numbers that follow from measured mode shapes: MAC, phase collinearity, phase deviation.

MAC and collinearity have their maximum where shapes agree or are real: there the slope is 0, and noise makes them smaller, never
greater. First-order propagation sees neither, so shapes are drawn from their covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.errors import InputError
from structid.modal.modal_record import ModalRecord
from structid.modal.poles.poles import modal_phase_collinearity, modal_phase_deviation

_DRAWS = 500  # by which a standard deviation is known to 3 %


@dataclass(frozen=True, eq=False)
class ShapeQuantity:
    """Numbers that follow from measured shapes, with what the errors of the shapes do to them.

    Attributes
    ----------
    value : float array
        The numbers for the shapes as measured.
    std : float array
        Standard deviation; NaN where the shapes have none. Up to twice too large where the truth is at its limit (a MAC of 1).
    noise_effect : float array
        What errors of the shapes add on average: negative for MAC and collinearity. `value` less this is the better estimate.
    """

    value: FloatArray
    std: FloatArray
    noise_effect: FloatArray


def collinearity_with_std(modes: ModalRecord) -> ShapeQuantity:
    """Modal phase collinearity of every mode, (n_modes,), with its standard deviation."""
    return _of_every_mode(modes, modal_phase_collinearity)


def phase_deviation_with_std(modes: ModalRecord) -> ShapeQuantity:
    """Mean phase deviation of every mode in degrees, (n_modes,), with its standard deviation."""
    return _of_every_mode(modes, modal_phase_deviation)


def mac_with_std(first: ModalRecord, second: ModalRecord) -> ShapeQuantity:
    """Modal assurance criterion of all pairs of modes of two records, (n_first, n_second), with its standard deviation.

    Errors of different records are independent; those of one record are taken with all of their covariance where it has
    `changes`, else entry by entry from `shape_std`. A record without either counts as exact, as the modes of a model are.

    Parameters
    ----------
    first, second : ModalRecord
        At the same channels in the same order. An entry that one of them does not know has no part in a pair.

    Returns
    -------
    ShapeQuantity
        MAC, its standard deviation and what errors add to it on average; the last two are NaN if neither record has errors.

    Raises
    ------
    InputError
        If the channels differ.

    References
    ----------
    Greś, Döhler and Mevel (2021), Uncertainty quantification of the modal assurance criterion in operational modal analysis,
    Mech. Syst. Signal Process. 152, 107457: near 1 the MAC follows a quadratic form of Gaussian errors.

    Examples
    --------
    >>> import numpy as np
    >>> shapes = np.array([[1.0], [0.5]])
    >>> measured = ModalRecord([2.0], [0.01], shapes, ["1X", "2X"], shape_std=np.array([[0.0], [0.1]]))
    >>> model = ModalRecord([2.0], [0.01], shapes, ["1X", "2X"])
    >>> mac_with_std(measured, model).noise_effect.round(3).tolist()
    [[-0.006]]
    """
    if first.channels != second.channels:
        raise InputError("`second` must have the channels of `first` in the same order; use `some_channels`")
    rng = np.random.default_rng(0)
    draws = [_drawn_shapes(modes, rng) for modes in (first, second)]
    known = [modes.known.astype(float) for modes in (first, second)]
    shapes = [np.where(modes.known, modes.mode_shapes, 0.0) for modes in (first, second)]

    def mac_of(x: ComplexArray, y: ComplexArray) -> FloatArray:
        """MAC (..., n_first, n_second) of shapes `x` and `y` (..., n_channels, n_modes), over entries that both know.

        Unknown entries are 0 in the shapes; NaN for a pair that shares no known entry.
        """
        cross = np.abs(np.einsum("...ci,...cj->...ij", x.conj(), y)) ** 2
        of_first = np.einsum("...ci,cj->...ij", np.abs(x) ** 2, known[1])
        of_second = np.einsum("ci,...cj->...ij", known[0], np.abs(y) ** 2)
        energy = of_first * of_second
        return np.divide(cross, energy, out=np.full(cross.shape, np.nan), where=energy > 0)

    value = mac_of(*(shape.astype(complex) for shape in shapes))
    if all(part is None for part in draws):
        return ShapeQuantity(value, np.full_like(value, np.nan), np.full_like(value, np.nan))
    moved = [shape + (0.0 if part is None else part) for shape, part in zip(shapes, draws, strict=True)]
    return _summary(value, mac_of(*(part.astype(complex) for part in moved)))


def _of_every_mode(modes: ModalRecord, quantity: Callable[[ComplexArray], FloatArray]) -> ShapeQuantity:
    """`ShapeQuantity` (n_modes,) of a function of shapes, with standard deviations from 500 drawn sets of shapes.

    `quantity` maps shapes (n_channels, n) to values (n,). Deviations are NaN if `modes` state no errors of shapes. The
    random numbers are always the same.
    """
    shapes = modes.mode_shapes.astype(complex)
    value, changes = quantity(shapes), _drawn_shapes(modes, np.random.default_rng(0))
    if changes is None:
        return ShapeQuantity(value, np.full_like(value, np.nan), np.full_like(value, np.nan))
    columns = (shapes + changes).transpose(1, 0, 2).reshape(len(shapes), -1)
    return _summary(value, quantity(columns).reshape(_DRAWS, -1))


def _summary(value: FloatArray, drawn: FloatArray) -> ShapeQuantity:
    """`ShapeQuantity` of `value` and `drawn` (n_draws, ...): standard deviation over draws, and their mean less `value`."""
    return ShapeQuantity(value, drawn.std(axis=0), drawn.mean(axis=0) - value)


def _drawn_shapes(modes: ModalRecord, rng: np.random.Generator) -> ComplexArray | None:
    """Random errors of the shapes, (500, n_channels, n_modes), 0 for unknown entries; None if no deviation is stated.

    `rng` draws them from `modes.changes`, or entry by entry from `modes.shape_std`; imaginary parts only where shapes
    are complex.
    """
    if modes.changes is not None:
        weights = rng.standard_normal((_DRAWS, len(modes.changes.frequency)))
        return np.einsum("db,bcm->dcm", weights, modes.changes.mode_shapes)
    if modes.shape_std is None:
        return None
    parts = rng.standard_normal((2, _DRAWS, *modes.shape_std.shape)) * np.nan_to_num(modes.shape_std)
    return np.asarray(parts[0] + 1j * np.iscomplexobj(modes.mode_shapes) * parts[1])
