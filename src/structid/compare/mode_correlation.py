"""Measured modes beside those of a model: pairs, likeness by mode and by sensor, orthogonality, expansion.

An expansion carries measured shapes from the sensors on to the model; its basis is the model seen from its sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from structid.compare.options import DEFAULT, CorrelateOptions
from structid.core.arrays import FloatArray, IntArray
from structid.core.display import join_words
from structid.core.errors import InputError, SingularModelError
from structid.dynamics import Modes
from structid.dynamics.normal_modes import modes
from structid.fem import Structure
from structid.forward import ModalSettings
from structid.modal import ModalRecord
from structid.modal.modal_record import largest_entries
from structid.modal.shape_uncertainty import ShapeQuantity, mac_with_std
from structid.similarity import (
    Pairing,
    assign_pairs,
    comac,
    ecomac,
    most_real,
    orthogonality,
    pair_modes,
    subspace_angles,
)

#: Part of the largest singular value that counts as none.
_RANK = 1e-8
#: Condition of the modes at the sensors beyond which they cannot be distinguished.
_WORST = 100.0


def constrained_shapes(dynamic_stiffness: sparse.csc_array, sensors: sparse.csc_array) -> FloatArray:
    """Shapes of a model with a unit motion at one sensor, 0 at the others and no other forces, (n_dofs, n_channels).

    Column c is for sensor c: the solution x of Z x = S f, S' x = e, with the forces f at the sensors and the unit
    vector e of c. With Z = K it is Guyan's (1965) reduction, with Z = K - omega^2 M the dynamic expansion of Kidder
    (1973). Sensors may read sums of degrees of freedom.

    Parameters
    ----------
    dynamic_stiffness : (n_dofs, n_dofs) sparse array
        Z, symmetric; singular where the structure is free, as long as the sensors hold it.
    sensors : (n_dofs, n_channels) sparse array
        S, see `Structure.selection`.

    Raises
    ------
    InputError
        If there is no sensor, or sensors read the same motion.
    SingularModelError
        If the sensors leave a motion without stiffness free.

    References
    ----------
    Guyan (1965), AIAA Journal 3(2), 380; Kidder (1973), AIAA Journal 11(6), 892-893.
    """
    n, count = sensors.shape
    values = np.linalg.eigvalsh((sensors.T @ sensors).toarray())
    if not count or values[0] <= _RANK * values[-1]:
        raise InputError("sensors read the same motion more than once; leave one of them out with `channels_used`")
    size = float(np.abs(dynamic_stiffness.diagonal()).mean()) or 1.0
    border = size * sensors
    whole = sparse.block_array([[dynamic_stiffness, border], [border.T, None]], format="csc")
    right = np.zeros((n + count, count))
    right[n:] = size * np.eye(count)
    try:
        solution = np.asarray(splu(whole).solve(right)[:n])
    except RuntimeError as error:
        raise SingularModelError(
            "the model can move without force while every sensor stands still; add supports or sensors"
        ) from error
    return solution


def serep_basis(seen: FloatArray, mode_shapes: FloatArray) -> FloatArray:
    """Sums of modes that are 1 at one sensor and 0 at the others, as closely as they can be, (n_dofs, n_channels).

    This is T = Phi (S' Phi)^+, exact where there are as many modes as sensors, else in the sense of least squares.

    Parameters
    ----------
    seen : (n_channels, n_modes) float array
        The modes at the sensors, S' Phi.
    mode_shapes : (n_dofs, n_modes) float array
        Phi.

    References
    ----------
    O'Callahan, Avitabile and Riemer (1989), System equivalent reduction expansion process (SEREP), Proc. 7th IMAC.
    """
    return np.asarray(mode_shapes @ np.linalg.pinv(seen, rcond=_RANK))


def reduced_mass(mass: sparse.csc_array, basis: FloatArray) -> FloatArray:
    """Reduced mass matrix T' M T, (n_channels, n_channels), for a basis T of `constrained_shapes` or `serep_basis`."""
    return np.asarray(basis.T @ (mass @ basis))


@dataclass(frozen=True, eq=False)
class ExpandedShapes:
    """Measured shapes on all degrees of freedom.

    Attributes
    ----------
    shapes : (n_dofs, n_modes) float array
        In the scale of the measured shapes; NaN of a mode without a known entry, as are all others of it.
    std : (n_dofs, n_modes) float array
        From noise of the shapes and, where stated, error of the model; NaN where neither is known.
    residual : (n_channels, n_modes) float array
        Expanded less measured, at the sensors; zero of a dynamic expansion, which keeps what was measured; NaN where an
        entry is unknown.
    noise : (n_channels, n_modes) float array
        Standard deviation of the measured entries that was counted on: stated, or from the residual.
    basis : tuple of tuple of int
        Modes of the model that each shape is made of; () of a dynamic expansion, and where no entry is known.
    """

    shapes: FloatArray
    std: FloatArray
    residual: FloatArray
    noise: FloatArray
    basis: tuple[tuple[int, ...], ...]


def expand(
    measured: FloatArray,
    frequency: FloatArray,
    sensors: sparse.csc_array,
    modes: Modes,
    basis: Sequence[Sequence[int]],
    *,
    shape_std: FloatArray | None = None,
    model_error: float = 0.0,
    dynamic: tuple[sparse.csc_array, sparse.csc_array] | None = None,
) -> ExpandedShapes:
    """Measured shapes psi = S' x + n, known at sensors, expanded to shapes x = G psi at all degrees of freedom.

    SEREP takes G = Phi_b (S' Phi_b)^+ with the modes b of `basis`: shapes are sums of those modes. The dynamic
    expansion takes the motion at the measured frequency without force where no sensor is, see `constrained_shapes`.

    The error of x is (I - G S') e - G n. Noise n has the covariance diag(`shape_std`)^2. An error of the model turns
    its mode r towards the others, e = q sum_j c_j phi_j; with a `model_error` of eps its stiffness errs between two
    modes by phi_j' dK phi_r = E_jr omega_j omega_r, E_jr of standard deviation eps, so that std(c_j) = eps omega_j
    omega_r / |omega_j^2 - omega_r^2|, and never above 1, to first order. Far above r it is c = -(I + E)^-1 E_r, whose
    variance n modes together raise by 1 + 3 n eps^2, to second order. q is the part of phi_r in x.

    Parameters
    ----------
    measured : (n_channels, n_modes) float array
        Real shapes psi, see `structid.similarity.most_real`; NaN where an entry is unknown: each shape is expanded from
        the sensors at which it is known.
    frequency : (n_modes,) float array
        Measured natural frequencies, Hz.
    sensors : (n_dofs, n_channels) sparse array
        S, see `Structure.selection`.
    modes : Modes
        Modes of the model: those of `basis`, and those that an error of the model may bring in.
    basis : sequence of sequence of int
        For each measured shape the model modes b, counted from 0, its partner first. Modes that the sensors cannot
        distinguish from earlier ones are not used.
    shape_std : (n_channels, n_modes) float array, optional
        Standard deviation of every entry; from the residual of SEREP where sensors are more than modes, else unknown.
    model_error : float
        eps, relative. Elements that are each off by 10 % independently make about 0.1 over the root of their number. It
        is taken to second order: n eps^2, the relative variance of a stiffness error, is to stay below 0.1.
    dynamic : (mass, stiffness), optional
        Matrices (n_dofs, n_dofs) for the dynamic expansion; without them it is SEREP.

    Returns
    -------
    ExpandedShapes
        Shapes and standard deviations (n_dofs, n_modes), residuals and noise at the sensors, and the modes used for
        each shape. What is unknown is NaN, as is a shape without a known entry.

    Raises
    ------
    InputError
        If sizes disagree, or no mode of the basis moves the sensors.

    References
    ----------
    O'Callahan, Avitabile and Riemer (1989), Proc. 7th IMAC; Kidder (1973), AIAA Journal 11(6), 892-893; Brincker,
    Skafte, Lopez-Aenlle, Sestieri, D'Ambrogio and Canteli (2014), Mech. Syst. Signal Process. 45, 91-104, for few modes
    near the measured one as the basis; Fox and Kapoor (1968), AIAA Journal 6(12), 2426-2429, Eq. (24) for the turning.
    """
    n_channels, n_modes = measured.shape
    if sensors.shape[1] != n_channels or len(frequency) != n_modes or len(basis) != n_modes or not all(map(len, basis)):
        raise InputError(
            f"`measured` is {measured.shape}, and `sensors` has {sensors.shape[1]} channels, `frequency` {len(frequency)} and"
            f" `basis` {len(basis)} modes; they must agree, and every shape needs a mode"
        )
    everywhere = np.asarray(sensors.T @ modes.mode_shapes)
    shapes, std = (np.full((sensors.shape[0], n_modes), np.nan) for _ in range(2))
    residual, noise = (np.full(measured.shape, np.nan) for _ in range(2))
    used: list[tuple[int, ...]] = []
    for r in range(n_modes):
        rows = np.flatnonzero(~np.isnan(measured[:, r]))
        if not len(rows):
            used.append(())
            continue
        seen, entries = everywhere[rows], measured[rows, r]
        if dynamic is None:
            chosen = _distinguishable(seen, basis[r])
            carry = modes.mode_shapes[:, chosen] @ np.linalg.pinv(seen[:, chosen])
        else:
            mass, stiffness = dynamic
            omega = 2 * np.pi * float(frequency[r])
            chosen, carry = (), constrained_shapes(sparse.csc_array(stiffness - omega**2 * mass), sensors[:, rows])
        shapes[:, r] = carry @ entries
        residual[rows, r] = (sensors.T @ shapes[:, r])[rows] - entries
        if shape_std is not None:
            noise[rows, r] = shape_std[rows, r]
        elif chosen and len(rows) > len(chosen):
            noise[rows, r] = np.sqrt((residual[rows, r] ** 2).sum() / (len(rows) - len(chosen)))
        variance = np.square(carry) @ np.square(noise[rows, r])
        if model_error > 0:
            left = modes.mode_shapes - carry @ seen
            near = chosen or _distinguishable(seen, basis[r])
            part = float((np.linalg.pinv(seen[:, near]) @ entries)[0])
            variance = variance + np.square(left) @ (part**2 * _mixing_variance(modes, near[0], model_error))
        std[:, r] = np.sqrt(variance)
        used.append(chosen)
    return ExpandedShapes(shapes, std, residual, noise, tuple(used))


def _distinguishable(seen: FloatArray, modes: Sequence[int]) -> tuple[int, ...]:
    """Indices from `modes`, in order, of those whose shapes at the sensors are distinguishable.

    Scaled to a largest entry of 1, they together have a condition number of at most 100; a mode that depends on earlier
    ones is left out. `seen` (n_channels, n_modes) are the shapes of all modes of the model at the sensors.

    Raises
    ------
    InputError
        If none of `modes` moves the sensors.
    """
    size = np.abs(seen).max(axis=0)
    chosen: list[int] = []
    for k in modes:
        candidates = [*chosen, k]
        values = np.linalg.svd(seen[:, candidates] / np.maximum(size[candidates], 1e-300), compute_uv=False)
        if size[k] > 0 and len(candidates) <= len(seen) and values[0] <= _WORST * values[-1]:
            chosen.append(k)
    if not chosen:
        raise InputError("no mode of the model that a shape could be made of moves the sensors; check the channels")
    return tuple(chosen)


def _mixing_variance(modes: Modes, index: int, model_error: float) -> FloatArray:
    """Variance of each model mode's part in a measured shape, (n_modes,), over the squared part of the mode `index`.

    A relative stiffness error `model_error` mixes modes the more, the closer their frequencies are. The variance is
    below 1, and set to 1 for `index` itself, which counts from 0.
    """
    squares = (2 * np.pi * modes.frequency) ** 2
    together = model_error**2 * (1 + 3 * len(squares) * model_error**2)
    between = together * squares[index] * squares
    variance = between / ((squares - squares[index]) ** 2 + between + np.finfo(float).tiny)
    variance[index] = 1.0
    return np.asarray(variance)


#: Degrees of freedom beyond which all modes are not sought, and beyond which no mass is reduced statically.
_DENSE_UP_TO, _STATIC_UP_TO = 600, 30_000
#: Modes of the model, in parts of the range of those measured, that are shown beside them.
_SHOWN = (0.6, 1.4)
_SETTINGS = ModalSettings()
#: MAC from which two shapes are one; below, few sensors see high modes of the model like any shape.
_SAME = 0.9
#: Gain in mean MAC from which a sensor is said to be turned round.
_TURNED = 0.05


@dataclass(frozen=True, eq=False)
class ModesCorrelation:
    """Measured modes beside a model's at the same sensors. Modes count from 0; those at 0 Hz are left out.

    Attributes
    ----------
    name : str
    structure : Structure
    measured : ModalRecord
    model : Modes
    pairing : Pairing
    self_orthogonality : (n_measured, n_measured) float array or None
    cross_orthogonality : (n_measured, n_model) float array or None
        Of measured shapes with the mass reduced to the sensors; None where it cannot be, NaN of shapes that are not known
        at every sensor.
    expanded : ExpandedShapes or None
    options : CorrelateOptions
    notes : tuple of str
        What could not be done, and why.
    """

    name: str
    structure: Structure
    measured: ModalRecord
    model: Modes
    pairing: Pairing
    self_orthogonality: FloatArray | None
    cross_orthogonality: FloatArray | None
    expanded: ExpandedShapes | None
    options: CorrelateOptions
    notes: tuple[str, ...]

    @property
    def expansion_sizes(self) -> list[tuple[float, float]]:
        """Pairs (relative residual at the sensors, relative median deviation) of each expanded shape.

        Empty without an expansion. The residual is relative to the norm of the measured shape, the deviation to the
        largest entry of the expanded one. NaN where these are zero or unknown.
        """
        expanded = self.expanded
        if expanded is None:
            return []
        size = np.abs(expanded.shapes).max(axis=0)
        residual_energy, shape_energy = (np.nansum(values**2, axis=0) for values in (expanded.residual, self.shapes))
        residual = np.sqrt(
            np.divide(residual_energy, shape_energy, out=np.full(len(shape_energy), np.nan), where=shape_energy > 0)
        )
        median = np.median(expanded.std, axis=0) / np.where(size > 0, size, np.nan)
        return list(zip(residual.tolist(), median.tolist(), strict=True))

    @cached_property
    def sensors(self) -> sparse.csc_array:
        """Selection of the sensors among the degrees of freedom of the model, a sparse array (n_dofs, n_channels)."""
        return self.structure.selection(self.measured.channels)

    @cached_property
    def shapes(self) -> FloatArray:
        """Measured shapes turned to be as real as they can be, (n_channels, n_measured); NaN where an entry is unknown."""
        return most_real(self.measured.mode_shapes)

    @cached_property
    def seen(self) -> FloatArray:
        """Shapes of the model, of unit modal mass, at the sensors, (n_channels, n_model)."""
        return np.asarray(self.sensors.T @ self.model.mode_shapes)

    @cached_property
    def coefficients(self) -> FloatArray:
        """Least-squares coefficients of each measured shape in its model partners, (n_model, n_measured).

        A column has several entries for close modes, and only zeros for a mode without a pair or without a known entry.
        """
        matrix = np.zeros((self.seen.shape[1], self.shapes.shape[1]))
        for i in self.pairing.paired.tolist():
            known, partners = ~np.isnan(self.shapes[:, i]), list(self.pairing.partners(i))
            if known.any():
                matrix[partners, i] = np.linalg.lstsq(self.seen[known][:, partners], self.shapes[known, i], rcond=None)[
                    0
                ]
        return matrix

    @cached_property
    def _pairs_at_sensors(self) -> tuple[FloatArray, FloatArray]:
        """Measured shapes of pairs that the sensors see, and the model shapes fitted to them, (n_channels, n) each."""
        pairs, like = self.pairing.paired, self.seen @ self.coefficients[:, self.pairing.paired]
        moving = np.abs(np.where(np.isnan(self.shapes[:, pairs]), 0.0, like)).max(axis=0, initial=0.0) > 0
        return self.shapes[:, pairs[moving]], like[:, moving]

    @property
    def comac(self) -> FloatArray:
        """COMAC of each sensor over all pairs and known entries, (n_channels,); NaN where there is none."""
        x, y = self._pairs_at_sensors
        return comac(x, y) if x.size else np.full(len(x), np.nan)

    @property
    def ecomac(self) -> FloatArray:
        """Enhanced COMAC of each sensor over all pairs and known entries, (n_channels,); NaN where there is none."""
        x, y = self._pairs_at_sensors
        return ecomac(x, y) if x.size else np.full(len(x), np.nan)

    @cached_property
    def mac_of_pairs(self) -> ShapeQuantity:
        """MAC of each measured mode with its mode of the model, (n_measured,), with its deviation by the errors of the shape.

        NaN without a pair; deviation and effect of noise are NaN too where the record does not state the errors of the whole shape.
        """
        value, std, by_noise = np.full((3, self.measured.n_modes), np.nan)
        for i in self.pairing.paired.tolist():
            k = [int(self.pairing.number[i])]
            value[i] = self.pairing.mac[i, k[0]]
            if self._has_stated_errors(i):
                of_model = ModalRecord(self.model.frequency[k], [np.nan], self.seen[:, k], self.measured.channels)
                mac = mac_with_std(self.measured.some_modes([i]), of_model)
                std[i], by_noise[i] = mac.std[0, 0], mac.noise_effect[0, 0]
        return ShapeQuantity(value, std, by_noise)

    def _has_stated_errors(self, mode: int) -> bool:
        """True if the record states the errors of the shape of measured mode `mode` (from 0) at every known entry."""
        measured = self.measured
        if measured.changes is not None:
            return True
        if measured.shape_std is None:
            return False
        return not np.isnan(measured.shape_std[measured.known[:, mode], mode]).any()

    @property
    def n_paired(self) -> int:
        return len(self.pairing.paired)

    @cached_property
    def shown(self) -> IntArray:
        """Indices of the model modes to show beside the measured ones, ascending.

        These are all with a pair, and those that move a sensor and lie between 0.6 times the lowest and 1.4 times the
        highest measured frequency. The result is (n_shown,), counted from 0.
        """
        f, g = self.measured.frequency, self.model.frequency
        near = (g >= _SHOWN[0] * f[0]) & (g <= _SHOWN[1] * f[-1]) & _moving(self.pairing)
        near[self.pairing.number[self.pairing.paired]] = True
        return np.flatnonzero(near)

    @property
    def frequency_difference(self) -> FloatArray:
        """Relative frequency difference, model / measured - 1, of every measured mode, (n_measured,); NaN without a pair."""
        number = self.pairing.number
        ratio = self.model.frequency[number] / self.measured.frequency - 1
        return np.where(number >= 0, ratio, np.nan)

    def remark(self, mode: int) -> str:
        """A remark on the pair of a measured mode: missing, a group of close modes, ambiguous, or paired by frequency.

        It is "" if there is none. `mode` counts from 0, the modes in the text from 1. Of a missing mode it names the
        nearest mode of the model, and why that is no pair.
        """
        pairing, f, i = self.pairing, self.model.frequency, mode
        has_no_entry = not self.measured.known[:, i].any()
        if pairing.number[i] < 0:
            best = int(pairing.mac[i].argmax()) if pairing.mac.shape[1] else -1
            if has_no_entry or best < 0 or pairing.mac[i, best] == 0:
                return "missing in the model"
            like = f"missing in the model: nearest is mode {best + 1}, {f[best]:.5g} Hz, MAC {pairing.mac[i, best]:.2f}"
            owner = next((k for k in pairing.paired.tolist() if best in pairing.partners(k)), None)
            if owner is not None:
                return f"{like}, the pair of measured mode {owner + 1}"
            return like + (", too far off in frequency" if pairing.mac[i, best] >= self.options.least_mac else "")
        words = ["no shape entry is known: paired by frequency alone"] if has_no_entry else []
        for measured, model in pairing.groups:
            if i in measured:
                complete = self.measured.known[:, measured].all(axis=1)
                angle = subspace_angles(self.shapes[complete][:, measured], self.seen[complete][:, model])[-1]
                members = " and ".join(str(k + 1) for k in model)
                words.append(
                    f"close modes: held against modes {members} together, largest angle {np.degrees(angle):.2g}°"
                )
        for k in pairing.ambiguous.get(i, ()):
            words.append(f"ambiguous: mode {k + 1}, {f[k]:.5g} Hz, MAC {pairing.mac[i, k]:.2f}, is as good")
        return "; ".join(words)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on what could not be computed, missing, surplus and ambiguous modes, and reversed sensors."""
        messages = list(self.notes)
        surplus, far = self.pairing.surplus, _too_far(self)
        missing = [i for i in self.pairing.missing.tolist() if i not in far]
        if missing:
            messages.append(
                f"no mode of the model matches the modes measured at {_listed(self.measured.frequency[missing])} Hz (MAC below"
                f" {self.options.least_mac:g} with unpaired modes near in frequency): check sensors and model; they may be no"
                " modes of the structure"
            )
        if far:
            messages.append(
                f"the shapes measured at {_listed(self.measured.frequency[list(far)])} Hz are the model's at"
                f" {_listed(self.model.frequency[list(far.values())])} Hz, too far off in frequency for pairs: check"
                " units, stiffness and mass of the model, or raise `frequency_guard` in [record.modes]"
            )
        if surplus:
            messages.append(
                f"no measured mode is like the model's at {_listed(self.model.frequency[list(surplus)])} Hz: missed in the"
                " test, or the model has motions that the structure has not"
            )
        if self.pairing.ambiguous:
            numbers = ", ".join(str(i + 1) for i in self.pairing.ambiguous)
            messages.append(f"pairs of measured modes {numbers} are ambiguous: other modes of the model are as good")
        if len(self.measured.channels) == 1:
            messages.append("there is one sensor: every MAC is 1, and modes are paired by frequency alone")
        return (*messages, *_reversed_sensor(self))


def _too_far(correlation: ModesCorrelation) -> dict[int, int]:
    """Measured modes without a pair whose shape matches a model mode (MAC 0.9) too far off in frequency.

    A mapping from the index of the measured mode to that of the model mode, which is in no pair.
    """
    free = np.ones(len(correlation.model.frequency), dtype=bool)
    free[[k for i in correlation.pairing.paired.tolist() for k in correlation.pairing.partners(i)]] = False
    far = {}
    for i in correlation.pairing.missing.tolist():
        free_mac = np.where(free, correlation.pairing.mac[i], 0.0)
        if free_mac.max(initial=0.0) >= _SAME:
            far[i] = int(free_mac.argmax())
    return far


def _reversed_sensor(correlation: ModesCorrelation) -> list[str]:
    """A sentence on the sensor whose reversed sign raises the mean MAC most, in a list.

    The mean is over the measured modes, each with one mode of the model near in frequency at most. The list is empty
    unless it rises by 0.05 or more, and to the least MAC of a pair; empty as well for fewer than two modes or three
    sensors.
    """
    use = np.flatnonzero(correlation.pairing.nearness.any(axis=0))
    if correlation.measured.n_modes < 2 or len(correlation.shapes) < 3 or not len(use):
        return []
    known, nearness = correlation.measured.known, correlation.pairing.nearness[:, use]
    x, y = np.where(known, correlation.shapes, 0.0), correlation.seen[:, use]
    product, energy = x.T @ y, (x**2).sum(axis=0)[:, None] * (known.T @ y**2)
    n_shapes = max(1, int(known.any(axis=0).sum()))

    def mean_mac(product: FloatArray) -> float:
        mac = np.where(nearness > 0, product**2 / np.where(energy > 0, energy, np.inf), 0.0)
        return float(mac[assign_pairs(mac * nearness)].sum() / n_shapes)

    now = mean_mac(product)
    mac_reversed = [mean_mac(product - 2 * np.outer(a, b)) for a, b in zip(x, y, strict=True)]
    best = int(np.argmax(mac_reversed))
    if mac_reversed[best] - now < _TURNED or mac_reversed[best] < correlation.options.least_mac:
        return []
    return [
        f"{correlation.measured.channels[best]} reads with the opposite sense: with its sign changed, the mean MAC rises from"
        f" {now:.2f} to {mac_reversed[best]:.2f}; correct it in the record, or with `relabel`"
    ]


def _listed(values: FloatArray) -> str:
    return join_words([f"{value:.5g}" for value in values.tolist()])


def correlated_modes(
    structure: Structure,
    values: FloatArray,
    record: ModalRecord,
    options: CorrelateOptions = DEFAULT,
    settings: ModalSettings = _SETTINGS,
    name: str = "",
) -> ModesCorrelation:
    """Comparison of the modes of `record` with those of `structure` at the property values `values`.

    What cannot be computed, as orthogonality or expansion, is None in the result, with a note why.

    Parameters
    ----------
    structure : Structure
        Structure that has the record's channels.
    values : (n_values,) float array
        Property values in the order of the structure, in SI units.
    record : ModalRecord
        Measured modes; those at 0 Hz are left out.
    options : CorrelateOptions
        Least MAC of a pair, reduction and expansion.
    settings : ModalSettings
        Only `closeness`, `frequency_guard` and `shape_error` are used.
    name : str
        Name of the record in the result.

    Raises
    ------
    InputError
        If there is no mode above 0 Hz, no channel, or a channel that is not part of the structure.
    """
    structure.require_modes("modes")
    record = record.some_modes(np.flatnonzero(record.frequency > 0))
    if not record.known.any():
        raise InputError("the record has no mode above 0 Hz with a shape; there is nothing to pair")
    sensors = structure.selection(record.channels)
    mass, stiffness, damping, structural = (
        structure.matrix(matrix_kind, values) for matrix_kind in ("mass", "stiffness", "damping", "structural_damping")
    )
    count = None if structure.n_dofs <= _DENSE_UP_TO else 2 * record.n_modes + 10
    model = modes(mass, stiffness, damping, structural, count, partial(structure.strain_operator, values))
    seen, shapes = np.asarray(sensors.T @ model.mode_shapes), most_real(record.mode_shapes)
    pairing = pair_modes(
        record.frequency,
        record.mode_shapes,
        model.frequency,
        seen,
        least_mac=options.least_mac,
        closeness=settings.closeness,
        frequency_guard=settings.frequency_guard,
    )
    pairs, notes, known = pairing.paired, [], ~np.isnan(shapes)
    bases = [
        _expansion_basis(model, int(known[:, i].sum()), pairing, i, float(f)) for i, f in enumerate(record.frequency)
    ]
    own = cross = expanded = None
    try:
        reduced = _sensor_mass(mass, stiffness, sensors, model, seen, pairs, pairing, options)
        whole, use = np.flatnonzero(known.all(axis=0)), np.flatnonzero(_moving(pairing))
        if not len(whole):
            raise InputError("no shape is known at every sensor")
        own, cross = np.full((record.n_modes,) * 2, np.nan), np.zeros_like(pairing.mac)
        own[np.ix_(whole, whole)] = orthogonality(reduced, shapes[:, whole])
        cross[~known.all(axis=0)] = np.nan
        cross[np.ix_(whole, use)] = orthogonality(reduced, shapes[:, whole], seen[:, use])
    except (InputError, ArithmeticError) as error:
        notes.append(f"no orthogonality with the reduced mass: {error}")
    try:
        dynamic = (mass, stiffness) if options.expansion == "dynamic" else None
        std = _shape_std(record, shapes, settings.shape_error)
        expanded = expand(
            shapes, record.frequency, sensors, model, bases,
            shape_std=std, model_error=options.model_error, dynamic=dynamic,
        )  # fmt: skip
    except (InputError, ArithmeticError) as error:
        notes.append(f"no expansion of the measured shapes: {error}")
    return ModesCorrelation(name, structure, record, model, pairing, own, cross, expanded, options, tuple(notes))


def _moving(pairing: Pairing) -> NDArray[np.bool_]:
    """Mask (n_model,) of the modes of the model that move the sensors: their MAC with some measured mode is above 0."""
    return np.asarray((pairing.mac > 0).any(axis=0))


def _expansion_basis(model: Modes, n_known: int, pairing: Pairing, mode: int, frequency: float) -> tuple[int, ...]:
    """Indices of the model modes in which a measured shape is expanded: its partners, then the nearest in frequency.

    Distance is the logarithm of the ratio to the frequency of the first partner, or without partners to `frequency`,
    that of the measured mode in Hz. The others are modes of pairs, or, where there are no pairs, all that move the
    sensors. There are at most half as many (rounded up) as known entries `n_known`, but all partners. `mode` is the
    index of the measured mode.
    """
    partners = pairing.partners(mode)
    first = (int(pairing.number[mode]), *(k for k in partners if k != pairing.number[mode])) if partners else ()
    centre = model.frequency[first[0]] if first else frequency
    moving = np.flatnonzero(_moving(pairing) & (model.frequency > 0))
    pool = sorted({*pairing.number[pairing.paired].tolist(), *(k for _, group in pairing.groups for k in group)})
    pool = pool or moving.tolist()
    near = sorted(pool, key=lambda k: abs(np.log(model.frequency[k] / centre)))
    most = max(len(first), (n_known + 1) // 2, 1)
    return tuple(dict.fromkeys((*first, *near)))[:most]


def _sensor_mass(
    mass: sparse.csc_array,
    stiffness: sparse.csc_array,
    sensors: sparse.csc_array,
    model: Modes,
    seen: FloatArray,
    pairs: IntArray,
    pairing: Pairing,
    options: CorrelateOptions,
) -> FloatArray:
    """Mass matrix reduced to the sensors, (n_sensors, n_sensors), by Guyan or SEREP reduction, as `options` choose.

    `mass` and `stiffness` are (n_dofs, n_dofs), `sensors` (n_dofs, n_sensors) selects the motion of the sensors, `seen`
    (n_sensors, n_modes) are the model's shapes there, and `pairs` the indices of the paired measured modes that SEREP
    uses, at most one a sensor. SEREP replaces Guyan for more than 30 000 degrees of freedom.

    Raises
    ------
    InputError
        If SEREP is used and there is no pair, or sensors read the same motion.
    """
    if options.reduction == "guyan" and sensors.shape[0] <= _STATIC_UP_TO:
        return reduced_mass(mass, constrained_shapes(stiffness, sensors))
    chosen = pairing.number[pairs][: len(seen)]
    if not len(chosen):
        raise InputError("SEREP needs pairs, and there is none")
    return reduced_mass(mass, serep_basis(seen[:, chosen], model.mode_shapes[:, chosen]))


def _shape_std(record: ModalRecord, shapes: FloatArray, stated: float) -> FloatArray | None:
    """Standard deviations of the entries of `shapes`, (n_channels, n_modes).

    None if the record has none and `stated` is 0. Those of the record and `stated` times the largest entry of each
    shape are added as independent errors, as squares.
    """
    if record.shape_std is None and stated == 0:
        return None
    of_record = np.zeros(shapes.shape) if record.shape_std is None else record.shape_std
    return np.hypot(of_record, stated * largest_entries(shapes))
