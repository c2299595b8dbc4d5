"""Measured modes beside those of a model: pairs, likeness by mode and by sensor, orthogonality, expansion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.compare.correlation.expansion import ExpandedShapes, constrained_shapes, expand, reduced_mass, serep_basis
from structid.compare.correlation.options import DEFAULT, CorrelateOptions
from structid.core.arrays import FloatArray, IntArray
from structid.core.display import listed
from structid.core.errors import InputError
from structid.dynamics import Modes
from structid.dynamics.normal_modes import modes
from structid.fem import Structure
from structid.forward import ModalSettings
from structid.modal import ModalRecord
from structid.modal.modal_record import largest_entries
from structid.similarity import Pairing, comac, ecomac, most_real, orthogonality, pair_modes, subspace_angles
from structid.similarity.pairing import assigned

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

    @cached_property
    def sensors(self) -> sparse.csc_array:
        """(n_dofs, n_channels)."""
        return self.structure.selection(self.measured.channels)

    @cached_property
    def shapes(self) -> FloatArray:
        """Measured, as real as can be, (n_channels, n_measured); NaN where an entry is unknown."""
        return most_real(self.measured.mode_shapes)

    @cached_property
    def seen(self) -> FloatArray:
        """Shapes of the model at the sensors, (n_channels, n_model)."""
        return np.asarray(self.sensors.T @ self.model.mode_shapes)

    @cached_property
    def coefficients(self) -> FloatArray:
        """The sum of the model's modes that is the like of each measured shape, in its scale, (n_model, n_measured).

        Of close modes several, of one without a pair, or without a known entry, none.
        """
        found = np.zeros((self.seen.shape[1], self.shapes.shape[1]))
        for i in self.pairing.paired.tolist():
            known, own = ~np.isnan(self.shapes[:, i]), list(self.pairing.partners(i))
            if known.any():
                found[own, i] = np.linalg.lstsq(self.seen[known][:, own], self.shapes[known, i], rcond=None)[0]
        return found

    @cached_property
    def _pairs_at_sensors(self) -> tuple[FloatArray, FloatArray]:
        """Measured shapes of pairs that the sensors see, and the model's likes of them, (n_channels, n) each."""
        pairs, like = self.pairing.paired, self.seen @ self.coefficients[:, self.pairing.paired]
        moving = np.abs(np.where(np.isnan(self.shapes[:, pairs]), 0.0, like)).max(axis=0, initial=0.0) > 0
        return self.shapes[:, pairs[moving]], like[:, moving]

    @property
    def comac(self) -> FloatArray:
        """Of each sensor over the pairs and the entries that are known, (n_channels,); NaN without one."""
        x, y = self._pairs_at_sensors
        return comac(x, y) if x.size else np.full(len(x), np.nan)

    @property
    def ecomac(self) -> FloatArray:
        """As `comac`."""
        x, y = self._pairs_at_sensors
        return ecomac(x, y) if x.size else np.full(len(x), np.nan)

    @property
    def n_paired(self) -> int:
        return len(self.pairing.paired)

    @cached_property
    def shown(self) -> IntArray:
        """Modes of the model worth showing beside the measured ones: pairs, and all near their range."""
        f, g = self.measured.frequency, self.model.frequency
        near = (g >= _SHOWN[0] * f[0]) & (g <= _SHOWN[1] * f[-1]) & _moving(self.pairing)
        near[self.pairing.number[self.pairing.paired]] = True
        return np.flatnonzero(near)

    @property
    def frequency_difference(self) -> FloatArray:
        """Model / measured less 1 of every measured mode, (n_measured,); NaN without a pair."""
        number = self.pairing.number
        ratio = self.model.frequency[number] / self.measured.frequency - 1
        return np.where(number >= 0, ratio, np.nan)

    def remark(self, mode: int) -> str:
        """What the reader should know of a measured mode's pair; "" where it is plain."""
        pairing, f, i = self.pairing, self.model.frequency, mode
        bare = not self.measured.known[:, i].any()
        if pairing.number[i] < 0:
            best = int(pairing.mac[i].argmax()) if pairing.mac.shape[1] else -1
            if bare or best < 0 or pairing.mac[i, best] == 0:
                return "missing in the model"
            like = f"missing in the model: nearest is mode {best + 1}, {f[best]:.5g} Hz, MAC {pairing.mac[i, best]:.2f}"
            owner = next((k for k in pairing.paired.tolist() if best in pairing.partners(k)), None)
            if owner is not None:
                return f"{like}, the pair of measured mode {owner + 1}"
            return like + (", too far off in frequency" if pairing.mac[i, best] >= self.options.least_mac else "")
        words = ["no shape entry is known: paired by frequency alone"] if bare else []
        for measured, model in pairing.groups:
            if i in measured:
                own = self.measured.known[:, measured].all(axis=1)
                angle = subspace_angles(self.shapes[own][:, measured], self.seen[own][:, model])[-1]
                members = " and ".join(str(k + 1) for k in model)
                words.append(
                    f"close modes: held against modes {members} together, largest angle {np.degrees(angle):.2g}°"
                )
        for k in pairing.ambiguous.get(i, ()):
            words.append(f"ambiguous: mode {k + 1}, {f[k]:.5g} Hz, MAC {pairing.mac[i, k]:.2f}, is as good")
        return "; ".join(words)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the pairs say of model and test: missing, surplus and doubtful modes, and sensors that stand out."""
        found = list(self.notes)
        surplus, far = self.pairing.surplus, _too_far(self)
        missing = [i for i in self.pairing.missing.tolist() if i not in far]
        if missing:
            found.append(
                f"the model has no like of the modes measured at {_listed(self.measured.frequency[missing])} Hz (MAC below"
                f" {self.options.least_mac:g} with what is near in frequency and free): check sensors and model, or they are no"
                " modes of the structure"
            )
        if far:
            found.append(
                f"the shapes measured at {_listed(self.measured.frequency[list(far)])} Hz are the model's at"
                f" {_listed(self.model.frequency[list(far.values())])} Hz, too far off in frequency for pairs: check"
                " units, stiffness and mass of the model, or raise `frequency_guard` in [record.modes]"
            )
        if surplus:
            found.append(
                f"no measured mode is like the model's at {_listed(self.model.frequency[list(surplus)])} Hz: missed in the"
                " test, or the model has motions that the structure has not"
            )
        if self.pairing.ambiguous:
            numbers = ", ".join(str(i + 1) for i in self.pairing.ambiguous)
            found.append(f"pairs of measured modes {numbers} are ambiguous: other modes of the model are as good")
        if len(self.measured.channels) == 1:
            found.append("there is one sensor: every MAC is 1, and modes are paired by frequency alone")
        return (*found, *_turned(self))


def _too_far(found: ModesCorrelation) -> dict[int, int]:
    """Measured modes whose shape is the model's at a frequency too far off for a pair, with that mode of the model."""
    free = np.ones(len(found.model.frequency), dtype=bool)
    free[[k for i in found.pairing.paired.tolist() for k in found.pairing.partners(i)]] = False
    far = {}
    for i in found.pairing.missing.tolist():
        like = np.where(free, found.pairing.mac[i], 0.0)
        if like.max(initial=0.0) >= _SAME:
            far[i] = int(like.argmax())
    return far


def _turned(found: ModesCorrelation) -> list[str]:
    """The sensor that agrees much better if it is turned round; modes are paired anew for each, as it may have cost them."""
    use = np.flatnonzero(found.pairing.nearness.any(axis=0))
    if found.measured.n_modes < 2 or len(found.shapes) < 3 or not len(use):
        return []
    known, nearness = found.measured.known, found.pairing.nearness[:, use]
    x, y = np.where(known, found.shapes, 0.0), found.seen[:, use]
    product, energy = x.T @ y, (x**2).sum(axis=0)[:, None] * (known.T @ y**2)
    n_shapes = max(1, int(known.any(axis=0).sum()))

    def mean_mac(product: FloatArray) -> float:
        mac = np.where(nearness > 0, product**2 / np.where(energy > 0, energy, np.inf), 0.0)
        return float(mac[assigned(mac * nearness)].sum() / n_shapes)

    now = mean_mac(product)
    turned = [mean_mac(product - 2 * np.outer(a, b)) for a, b in zip(x, y, strict=True)]
    best = int(np.argmax(turned))
    if turned[best] - now < _TURNED or turned[best] < found.options.least_mac:
        return []
    return [
        f"{found.measured.channels[best]} reads with the opposite sense: turned round it raises the mean MAC of the modes from"
        f" {now:.2f} to {turned[best]:.2f}; correct it in the record, or with `relabel`"
    ]


def _listed(values: FloatArray) -> str:
    return listed([f"{value:.5g}" for value in values.tolist()])


def correlated_modes(
    structure: Structure,
    values: FloatArray,
    record: ModalRecord,
    options: CorrelateOptions = DEFAULT,
    settings: ModalSettings = _SETTINGS,
    name: str = "",
) -> ModesCorrelation:
    """The modes of `record` beside those of `structure` with the property values `values`.

    Parameters
    ----------
    structure : Structure
        Of which the record's channels are part.
    values : (n_values,) float array
    record : ModalRecord
    options : CorrelateOptions
    settings : ModalSettings
        Its `closeness`, `frequency_guard` and `shape_error` count.
    name : str

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
        structure.matrix(law, values) for law in ("inertia", "elastic", "viscous", "structural")
    )
    count = None if structure.n_dofs <= _DENSE_UP_TO else 2 * record.n_modes + 10
    model = modes(mass, stiffness, damping, structural, count, structure.strain_operator)
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
    bases = [_basis(model, int(known[:, i].sum()), pairing, i, float(f)) for i, f in enumerate(record.frequency)]
    own = cross = expanded = None
    try:
        reduced = _reduced(mass, stiffness, sensors, model, seen, pairs, pairing, options)
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


def _basis(model: Modes, n_known: int, pairing: Pairing, mode: int, frequency: float) -> tuple[int, ...]:
    """Modes that a measured shape is expanded in: its partners, then paired ones near it, half as many as known entries."""
    own = pairing.partners(mode)
    first = (int(pairing.number[mode]), *(k for k in own if k != pairing.number[mode])) if own else ()
    centre = model.frequency[first[0]] if first else frequency
    moving = np.flatnonzero(_moving(pairing) & (model.frequency > 0))
    pool = sorted({*pairing.number[pairing.paired].tolist(), *(k for _, group in pairing.groups for k in group)})
    pool = pool or moving.tolist()
    near = sorted(pool, key=lambda k: abs(np.log(model.frequency[k] / centre)))
    most = max(len(first), (n_known + 1) // 2, 1)
    return tuple(dict.fromkeys((*first, *near)))[:most]


def _reduced(
    mass: sparse.csc_array,
    stiffness: sparse.csc_array,
    sensors: sparse.csc_array,
    model: Modes,
    seen: FloatArray,
    pairs: IntArray,
    pairing: Pairing,
    options: CorrelateOptions,
) -> FloatArray:
    """The mass at the sensors."""
    if options.reduction == "guyan" and sensors.shape[0] <= _STATIC_UP_TO:
        return reduced_mass(mass, constrained_shapes(stiffness, sensors))
    chosen = pairing.number[pairs][: len(seen)]
    if not len(chosen):
        raise InputError("SEREP needs pairs, and there is none")
    return reduced_mass(mass, serep_basis(seen[:, chosen], model.mode_shapes[:, chosen]))


def _shape_std(record: ModalRecord, shapes: FloatArray, stated: float) -> FloatArray | None:
    """Standard deviation of the entries of `shapes`: the record's, and what is stated in parts of the largest."""
    if record.shape_std is None and stated == 0:
        return None
    own = np.zeros(shapes.shape) if record.shape_std is None else record.shape_std
    return np.hypot(own, stated * largest_entries(shapes))
