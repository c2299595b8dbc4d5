"""Errors of sensors and load cells as parameters of a record: gain, delay, polarity, and the decay of its window."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from structid.arrays import ComplexArray, FloatArray, IntArray, locked
from structid.dof import Dof, parse_dof
from structid.errors import InputError
from structid.records import FrfRecord
from structid.unknowns.named_unknowns import NamedUnknowns
from structid.unknowns.priors import Prior
from structid.unknowns.transforms import Transform, Transforms

ChannelProperty = Literal["gain", "delay", "polarity", "window_decay"]

#: Unit, start and transform of each kind of channel error; polarity is not continuous and has none.
_CONTINUOUS: dict[str, tuple[str, float, Transform]] = {
    "gain": ("1", 1.0, "log"),
    "delay": ("s", 0.0, "linear"),
    "window_decay": ("1/s", 1.0, "log"),
}
_ALL = "all"


@dataclass(frozen=True)
class ChannelUnknown:
    """A declaration: this error of these channels of a record is unknown.

    A channel's reading is ``polarity * gain * exp(-s delay)`` times the truth. A measured FRF is the reading of its
    sensor over that of its load, so an error of a load enters it inverted.

    Parameters
    ----------
    property : {"gain", "delay", "polarity", "window_decay"}
        ``gain`` (1): reading over truth, positive. ``delay`` (s): how late the channel is. ``polarity``: +1 or -1,
        decided by the data. ``window_decay`` (1/s): of an exponential window on all channels, which has no channels
        of its own: the measured FRF is H at s = decay + i omega. It adds to a decay that the record states.
    outputs, inputs : str or sequence of str
        Sensors and loads; ``"all"`` for all of them.
    each : bool
        One parameter a channel instead of one for all; always so for polarity.
    start : float, optional
        Initial value: 1 for a gain, 0 s for a delay; a window's decay needs one.
    name : str, optional
        What stands in the brackets of the parameter's name, so that records of one fit share an error; the channels
        by default.
    bounds : (float, float), optional
        The parameter stays strictly between them.
    prior : Prior, optional
        Such as a calibration's mean and standard deviation, in the parameter's unit.
    """

    property: ChannelProperty
    outputs: str | Sequence[str] = ()
    inputs: str | Sequence[str] = ()
    each: bool = False
    start: float | None = None
    name: str | None = None
    bounds: tuple[float, float] | None = None
    prior: Prior | None = None


@dataclass(frozen=True, eq=False)
class ChannelErrors(NamedUnknowns):
    """Errors of the channels of one record, as named parameters; made by `channel_errors`.

    The logarithm of the factor on the FRF of output o and input i is
    ``sum over gains exponents[k, o, i] log(p[k]) - s sum over delays exponents[k, o, i] p[k]``.

    A delay is judged against one radian at the highest line.

    Attributes
    ----------
    exponents : (n_params, n_outputs, n_inputs) float array
        +1 where the parameter belongs to the output, -1 where to the input, 0 where to neither or both.
    polarity_names : tuple of str
    polarity_members : (n_polarities, n_outputs, n_inputs) bool array
        FRFs whose sign each polarity turns.
    polarities : (n_polarities,) float array
        +1 or -1.
    """

    exponents: FloatArray
    polarity_names: tuple[str, ...]
    polarity_members: np.ndarray
    polarities: FloatArray

    @property
    def sign(self) -> FloatArray:
        """Polarity of every FRF, (n_outputs, n_inputs)."""
        return np.where(self.polarity_members, self.polarities[:, None, None], 1.0).prod(axis=0)

    def rows(self, kind: str) -> IntArray:
        """Which parameters are of that kind."""
        return np.array([i for i, own in enumerate(self.kinds) if own == kind], dtype=int)

    def factor(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """What the channels make of every FRF, (n_frequencies, n_outputs, n_inputs).

        Parameters
        ----------
        physical : (n_params,) float array
        laplace : (n_frequencies,) complex array
            s, 1/s.
        """
        gains = self.rows("gain")
        size = np.exp(np.tensordot(np.log(physical[gains]), self.exponents[gains], 1))
        return self.sign * size * np.exp(-laplace[:, None, None] * self.lateness(physical))

    def lateness(self, physical: FloatArray) -> FloatArray:
        """Delay of every FRF, s, (n_outputs, n_inputs)."""
        delays = self.rows("delay")
        late: FloatArray = np.tensordot(physical[delays], self.exponents[delays], 1)
        return late

    def log_slopes(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Derivative of the factor's logarithm with respect to each parameter, (n_frequencies, n_outputs, n_inputs, n_params).

        A window's decay, which moves s itself, is left at 0.
        """
        slopes = np.zeros((len(laplace), *self.exponents.shape[1:], self.n_params), dtype=np.complex128)
        for k, kind in enumerate(self.kinds):
            if kind == "gain":
                slopes[..., k] = self.exponents[k] / physical[k]
            elif kind == "delay":
                slopes[..., k] = -laplace[:, None, None] * self.exponents[k]
        return slopes

    def decay(self, physical: FloatArray) -> float | None:
        """The window's decay, 1/s, where it is a parameter."""
        rows = self.rows("window_decay")
        return float(physical[rows[0]]) if len(rows) else None

    def decided(self, measured: ComplexArray, predicted: ComplexArray) -> ChannelErrors:
        """The same with the polarities by which model and measurement agree best in phase.

        Each line of each FRF has one vote, so that resonances do not outweigh the rest; one polarity is decided after
        another until none changes.

        Parameters
        ----------
        measured, predicted : (n_frequencies, n_outputs, n_inputs) complex arrays
            The record, and the model with the present polarities.
        """
        size = np.maximum(np.abs(measured) * np.abs(predicted), np.finfo(float).tiny)
        votes = ((np.conj(predicted) * measured).real / size).sum(axis=0) * self.sign
        polarities = np.array(self.polarities)
        for _ in range(1 + len(polarities)):
            before = polarities.copy()
            for k, members in enumerate(self.polarity_members):
                others = np.where(self.polarity_members, polarities[:, None, None], 1.0).prod(axis=0) * polarities[k]
                polarities[k] = 1.0 if (votes * others)[members].sum() >= 0 else -1.0
            if (before == polarities).all():
                break
        return replace(self, polarities=locked(polarities))


@dataclass(frozen=True)
class _Group:
    """One parameter in the making: which outputs and inputs it belongs to."""

    unknown: ChannelUnknown
    label: str
    outputs: tuple[int, ...]
    inputs: tuple[int, ...]

    @property
    def name(self) -> str:
        return f"{self.unknown.property}[{self.label}]"

    def exponents(self, record: FrfRecord) -> FloatArray:
        power = np.zeros((len(record.outputs), len(record.inputs)))
        power[list(self.outputs), :] += 1
        power[:, list(self.inputs)] -= 1
        return power


def channel_errors(record: FrfRecord, unknowns: Iterable[ChannelUnknown]) -> ChannelErrors:
    """The named channel errors that `unknowns` declare on `record`.

    Raises
    ------
    InputError
        If a declaration names a channel that the record lacks or no channel, two declarations claim the same error of
        a channel, a start lies outside its range, or a prior is not one.

    Examples
    --------
    >>> import numpy as np
    >>> record = FrfRecord(np.array([1.0]), np.ones((1, 2, 1)), ("1X", "2X"), ("1X",), "accelerance")
    >>> channel_errors(record, [ChannelUnknown("gain", "all", each=True), ChannelUnknown("delay", inputs="1X")]).names
    ('gain[1X+]', 'gain[2X+]', 'delay[load 1X+]')
    """
    groups = [group for unknown in unknowns for group in _groups(record, unknown)]
    _require_distinct(groups)
    free = [group for group in groups if group.unknown.property != "polarity"]
    poles = [group for group in groups if group.unknown.property == "polarity"]
    shape = (0, len(record.outputs), len(record.inputs))
    limits = [_limits(group) for group in free]
    radian = 1 / max(float(record.omega[-1]), np.finfo(float).tiny)
    made = ChannelErrors(
        names=tuple(group.name for group in free),
        kinds=tuple(group.unknown.property for group in free),
        units=tuple(_CONTINUOUS[group.unknown.property][0] for group in free),
        start=locked([_start(group) for group in free], float),
        transforms=Transforms(
            tuple("interval" if g.unknown.bounds else _CONTINUOUS[g.unknown.property][2] for g in free),
            locked([low for low, _ in limits], float),
            locked([high for _, high in limits], float),
        ),
        prior_mean=locked([g.unknown.prior.mean if g.unknown.prior else np.nan for g in free], float),
        prior_std=locked([g.unknown.prior.std if g.unknown.prior else np.nan for g in free], float),
        prior_lognormal=locked(
            [g.unknown.prior is not None and g.unknown.prior.kind == "lognormal" for g in free], bool
        ),
        scale=locked([radian if g.unknown.property == "delay" else 0.0 for g in free], float),
        exponents=locked(np.array([g.exponents(record) for g in free]).reshape(len(free), *shape[1:])),
        polarity_names=tuple(group.name for group in poles),
        polarity_members=locked(np.array([g.exponents(record) != 0 for g in poles], bool).reshape(-1, *shape[1:])),
        polarities=locked(np.ones(len(poles))),
    )
    _require_ranges(free, made)
    return made


def _groups(record: FrfRecord, unknown: ChannelUnknown) -> list[_Group]:
    if unknown.property not in (*_CONTINUOUS, "polarity"):
        known = ", ".join((*_CONTINUOUS, "polarity"))
        raise InputError(f"channel error `property` must be one of {known}, got {unknown.property!r}")
    outputs = _chosen("outputs", unknown.outputs, record.outputs)
    inputs = _chosen("inputs", unknown.inputs, record.inputs)
    if unknown.property == "window_decay":
        if outputs or inputs:
            raise InputError("a window's decay belongs to all channels; leave `outputs` and `inputs` out")
        if unknown.start is None:
            raise InputError("a window's decay needs a `start` in 1/s, such as the one set at the analyser")
        return [_Group(unknown, unknown.name or "all channels", (), ())]
    if not outputs and not inputs:
        raise InputError(f'{unknown.property} names no channel; give `outputs` or `inputs`, or outputs = "all"')
    if unknown.property == "polarity" and (unknown.prior or unknown.bounds or unknown.start is not None):
        raise InputError("a polarity is +1 or -1 and takes no `start`, `bounds` or `prior`; leave them out")
    labels = [str(record.outputs[o]) for o in outputs] + [f"load {record.inputs[i]}" for i in inputs]
    if not unknown.each and unknown.property != "polarity":
        return [_Group(unknown, unknown.name or ", ".join(labels), outputs, inputs)]
    ends = [((o,), ()) for o in outputs] + [((), (i,)) for i in inputs]
    single = len(ends) == 1
    prefix = "" if unknown.name is None else f"{unknown.name}:"
    named = [unknown.name if single and unknown.name else prefix + label for label in labels]
    return [_Group(unknown, label, *end) for label, end in zip(named, ends, strict=True)]


def _chosen(key: str, given: str | Sequence[str], channels: tuple[Dof, ...]) -> tuple[int, ...]:
    """Positions among `channels` of those named, whatever their sense."""
    texts = (given,) if isinstance(given, str) else tuple(given)
    if texts == (_ALL,):
        return tuple(range(len(channels)))
    own = [dof.unsigned for dof in channels]
    found = []
    for text in texts:
        dof = parse_dof(text).unsigned
        if dof not in own:
            words = [str(channel) for channel in channels]
            near = difflib.get_close_matches(str(text), words, 1, 0.0)
            raise InputError(
                f"`{key}` must name channels of the record, got {text!r}"
                + (f"; the nearest is {near[0]}" if near else "")
            )
        found.append(own.index(dof))
    return tuple(dict.fromkeys(found))


def _require_distinct(groups: list[_Group]) -> None:
    names: set[str] = set()
    owner: dict[tuple[str, str, int], str] = {}
    for group in groups:
        if group.name in names:
            raise InputError(f"two channel errors are called {group.name}; give one of them a `name`")
        names.add(group.name)
        ends = [("output", o) for o in group.outputs] + [("input", i) for i in group.inputs]
        for end, index in ends or [("window", 0)]:
            key = (group.unknown.property, end, index)
            if key in owner:
                raise InputError(f"{owner[key]} and {group.name} claim the same channel; take it out of one of them")
            owner[key] = group.name


def _start(group: _Group) -> float:
    return float(_CONTINUOUS[group.unknown.property][1] if group.unknown.start is None else group.unknown.start)


def _limits(group: _Group) -> tuple[float, float]:
    if group.unknown.bounds is not None:
        low, high = group.unknown.bounds
        if not low < high or (group.unknown.property != "delay" and low < 0):
            raise InputError(f"bounds of {group.name} must increase, from 0 unless a delay, got {group.unknown.bounds}")
        return float(low), float(high)
    return (0.0, np.inf) if group.unknown.property != "delay" else (-np.inf, np.inf)


def _require_ranges(groups: list[_Group], made: ChannelErrors) -> None:
    rows = zip(groups, made.names, made.start, made.transforms.lower, made.transforms.upper, strict=True)
    for group, name, value, low, high in rows:
        prior = group.unknown.prior
        if not low < value < high:
            raise InputError(f"initial value of {name} must lie between {low:g} and {high:g}, got {value:g}")
        if prior is not None and prior.problem:
            raise InputError(f"prior of {name} {prior.problem}")
        if prior is not None and prior.kind == "lognormal" and low < 0:
            raise InputError(f"{name} can be negative and takes no log-normal prior; give it `bounds` or a normal one")
