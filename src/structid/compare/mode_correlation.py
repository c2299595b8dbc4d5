"""Measured modes beside those of a model: pairs, likeness by mode and by sensor, orthogonality, expansion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.compare.expansion import ExpandedShapes, constrained_shapes, expand, reduced_mass, serep_basis
from structid.compare.options import DEFAULT, CorrelateOptions
from structid.core.arrays import FloatArray, IntArray
from structid.core.display import join_words
from structid.core.errors import InputError
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
        """Shapes of the model at the sensors, (n_channels, n_model)."""
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
        """True if the record states the error of every known entry of the shape of a measured mode (from 0)."""
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

    Empty unless it rises by 0.05 or more. Empty as well for fewer than two modes or three sensors, and where the mean
    MAC stays below the least MAC of a pair.
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
    """Modes of the model that move the sensors."""
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
