"""Errors of sensors and load cells (gain, delay, polarity, window decay), and declarations that make them unknown."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray, locked
from structid.core.dof import Dof, parse_dof
from structid.core.errors import InputError
from structid.unknowns.named_unknowns import NamedUnknowns, Transform, Transforms
from structid.unknowns.priors import Prior, priors_of

ChannelProperty = Literal["gain", "delay", "polarity", "window_decay"]
#: Unit, start and transform of each kind of channel error; polarity is not continuous and has none.
_CONTINUOUS: dict[str, tuple[str, float, Transform]] = {
    "gain": ("1", 1.0, "log"),
    "delay": ("s", 0.0, "linear"),
    "window_decay": ("1/s", 1.0, "log"),
}
_ALL = "all"


class ChannelsOfRecord(Protocol):
    """Sensors, loads and lines of a record of any kind, on which errors of channels are declared."""

    @property
    def outputs(self) -> tuple[Dof, ...]: ...

    @property
    def inputs(self) -> tuple[Dof, ...]: ...

    @property
    def frequency(self) -> FloatArray:
        """Hz, ascending."""


@dataclass(frozen=True, eq=False)
class ChannelErrors(NamedUnknowns):
    """Errors of the channels of one record, as named parameters; made by `channel_errors`.

    The logarithm of a channel's reading over the truth is the sum of the logarithms of its gains, less s times the sum
    of its delays. A delay is judged against one radian at the highest line.

    Attributes
    ----------
    outputs, inputs : tuple of Dof
        Sensors and loads of the record.
    of_outputs, of_inputs : (n_params, n_outputs), (n_params, n_inputs) bool arrays
        Channels that each parameter belongs to.
    polarity_names : tuple of str
    polarity_outputs, polarity_inputs : (n_polarities, n_outputs), (n_polarities, n_inputs) bool arrays
        The channel that each polarity turns.
    polarities : (n_polarities,) float array
        +1 or -1.
    """

    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    of_outputs: np.ndarray
    of_inputs: np.ndarray
    polarity_names: tuple[str, ...]
    polarity_outputs: np.ndarray
    polarity_inputs: np.ndarray
    polarities: FloatArray

    @property
    def exponents(self) -> FloatArray:
        """Power of each parameter in the factor on each FRF, (n_params, n_outputs, n_inputs)."""
        return self.of_outputs[:, :, None].astype(float) - self.of_inputs[:, None, :]

    @property
    def polarity_members(self) -> np.ndarray:
        """FRFs whose sign each polarity turns, (n_polarities, n_outputs, n_inputs) bool."""
        members: np.ndarray = self.polarity_outputs[:, :, None] | self.polarity_inputs[:, None, :]
        return members

    def seen_by(self, record: ChannelsOfRecord) -> ChannelErrors:
        """A copy for another record of the same test, with its sensors and loads in place of those of this record.

        A channel with the same degree of freedom, in either direction, keeps its errors; one that only `record` has
        gets none.
        """
        outputs, inputs = (_places(channels, other) for channels, other in
                           ((self.outputs, record.outputs), (self.inputs, record.inputs)))  # fmt: skip
        return replace(
            self, outputs=record.outputs, inputs=record.inputs,
            of_outputs=_taken(self.of_outputs, outputs), of_inputs=_taken(self.of_inputs, inputs),
            polarity_outputs=_taken(self.polarity_outputs, outputs), polarity_inputs=_taken(self.polarity_inputs, inputs),
        )  # fmt: skip

    def rows(self, kind: str) -> IntArray:
        """Indices of the parameters of that kind."""
        return np.array([i for i, parameter_kind in enumerate(self.kinds) if parameter_kind == kind], dtype=int)

    def readings(self, physical: FloatArray, laplace: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Complex factors from true to read values: of sensors (n_frequencies, n_outputs), and of load cells.

        The latter are (n_frequencies, n_inputs). A factor is the product of a channel's gains and polarities (+1 or -1)
        times exp(-s delay); 1 without errors.

        Parameters
        ----------
        physical : (n_params,) float array
            Gains, delays (s) and decays of windows, in the order of `names`.
        laplace : (n_frequencies,) complex array
            s, 1/s.
        """
        gains, delays = self.rows("gain"), self.rows("delay")
        sides = (self.of_outputs, self.polarity_outputs), (self.of_inputs, self.polarity_inputs)
        output, input_ = (
            np.where(turned, self.polarities[:, None], 1.0).prod(axis=0)
            * np.exp(np.log(physical[gains]) @ of[gains] - laplace[:, None] * (physical[delays] @ of[delays]))
            for of, turned in sides
        )
        return output, input_

    def factor(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Factor of the channel errors on every FRF, (n_frequencies, n_outputs, n_inputs); see `readings`."""
        output, input_ = self.readings(physical, laplace)
        return output[:, :, None] / input_[:, None, :]

    def lateness(self, physical: FloatArray) -> FloatArray:
        """Delay of every FRF, s, (n_outputs, n_inputs), from the values `physical` (n_errors,) of channel errors."""
        delays = self.rows("delay")
        late: FloatArray = np.tensordot(physical[delays], self.exponents[delays], 1)
        return late

    def log_slopes(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Derivative of the logarithm of `factor` by each error, (n_frequencies, n_outputs, n_inputs, n_params).

        `physical` (n_params,) are the errors, `laplace` (n_frequencies,) is s in 1/s. The column of a window's decay,
        which shifts s, is 0.
        """
        return np.einsum("fk,koi->foik", self._each_slope(physical, laplace), self.exponents)

    def output_slopes(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Derivative of the logarithm of each sensor's reading by the errors, (n_frequencies, n_outputs, n_params).

        `physical` (n_params,) are the errors, `laplace` (n_frequencies,) is s in 1/s.
        """
        return np.einsum("fk,ko->fok", self._each_slope(physical, laplace), self.of_outputs)

    def _each_slope(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Derivative of the logarithm of the reading of a channel by each error that it has, (n_frequencies, n_params).

        It is 1 / gain for a gain and -s for a delay, the same for every channel. `physical` (n_params,) are the errors,
        `laplace` (n_frequencies,) is s in 1/s. The column of a window's decay is 0.
        """
        slopes = np.zeros((len(laplace), self.n_params), dtype=np.complex128)
        gains = self.rows("gain")
        slopes[:, gains] = 1 / physical[gains]
        slopes[:, self.rows("delay")] = -laplace[:, None]
        return slopes

    def decay(self, physical: FloatArray) -> float | None:
        """The window's decay, 1/s, where it is a parameter."""
        rows = self.rows("window_decay")
        return float(physical[rows[0]]) if len(rows) else None

    def decided(self, measured: ComplexArray, predicted: ComplexArray) -> ChannelErrors:
        """Copy of these errors with the polarities by which model and measurement agree best in phase.

        Each line of each FRF has one vote, the cosine of the phase difference, so that resonances do not outweigh the
        rest. One polarity after another is set to the sign of its FRFs' votes, +1 for a sum of 0, until none changes.

        Parameters
        ----------
        measured, predicted : (n_frequencies, n_outputs, n_inputs) complex arrays
            FRFs of the record, and those of the model with the present polarities.
        """
        size = np.maximum(np.abs(measured) * np.abs(predicted), np.finfo(float).tiny)
        every = self.polarity_members
        sign = np.where(every, self.polarities[:, None, None], 1.0).prod(axis=0)
        votes = ((np.conj(predicted) * measured).real / size).sum(axis=0) * sign
        polarities = np.array(self.polarities)
        for _ in range(1 + len(polarities)):
            before = polarities.copy()
            for k, members in enumerate(every):
                others = np.where(every, polarities[:, None, None], 1.0).prod(axis=0) * polarities[k]
                polarities[k] = 1.0 if (votes * others)[members].sum() >= 0 else -1.0
            if (before == polarities).all():
                break
        return replace(self, polarities=locked(polarities))


def _places(own: tuple[Dof, ...], others: tuple[Dof, ...]) -> list[int]:
    """Index in `own` of each degree of freedom in `others`, regardless of direction; -1 where `own` lacks it."""
    places = {dof.unsigned: i for i, dof in enumerate(own)}
    return [places.get(dof.unsigned, -1) for dof in others]


def _taken(members: np.ndarray, places: list[int]) -> np.ndarray:
    """Columns `places` of the mask `members` (n_params, n_channels); False where a place is -1."""
    wider = np.concatenate([members, np.zeros((len(members), 1), dtype=bool)], axis=1)
    return locked(wider[:, places])


@dataclass(frozen=True)
class ChannelUnknown:
    """A declaration: this error of these channels of a record is unknown.

    A channel's reading is ``polarity * gain * exp(-s delay)`` times the truth. A measured FRF is the reading of its
    sensor over that of its load, so an error of a load enters it inverted; so it does in histories, where what is left
    of the motion before and after the record is read with the error of its sensor alone.

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


def _members(chosen: Sequence[tuple[int, ...]], n_channels: int) -> np.ndarray:
    """Table of the channels that each parameter belongs to, (n_params, n_channels) bool, read-only.

    `chosen` has the channel indices (from 0) of each parameter.
    """
    made = np.zeros((len(chosen), n_channels), dtype=bool)
    for row, members in zip(made, chosen, strict=True):
        row[list(members)] = True
    return locked(made)


def channel_errors(record: ChannelsOfRecord, unknowns: Iterable[ChannelUnknown]) -> ChannelErrors:
    """Channel errors of a record that `unknowns` declare, as named parameters with starts, bounds and priors.

    Gains, delays and decays of windows are the parameters, in the order of the declarations. Polarities are kept apart,
    start at +1 and are decided by `ChannelErrors.decided`.

    Parameters
    ----------
    record : FrfRecord or finite spectra
        Gives channels and frequencies; its values do not matter.
    unknowns : iterable of ChannelUnknown

    Raises
    ------
    InputError
        If a declaration names a channel that the record lacks or no channel, two declarations claim the same error of
        a channel, a start lies outside its range, or a prior is not one.

    Examples
    --------
    >>> import numpy as np
    >>> from structid import FrfRecord
    >>> record = FrfRecord(np.array([1.0]), np.ones((1, 2, 1)), ("1X", "2X"), ("1X",), "accelerance")
    >>> channel_errors(record, [ChannelUnknown("gain", "all", each=True), ChannelUnknown("delay", inputs="1X")]).names
    ('gain[1X+]', 'gain[2X+]', 'delay[load 1X+]')
    """
    groups = [group for unknown in unknowns for group in _parameters_of(record, unknown)]
    _require_distinct(groups)
    free = [group for group in groups if group.unknown.property != "polarity"]
    poles = [group for group in groups if group.unknown.property == "polarity"]
    n_out, n_in = len(record.outputs), len(record.inputs)
    limits = [_limits(group) for group in free]
    radian = 1 / max(2 * np.pi * float(record.frequency[-1]), np.finfo(float).tiny)
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
        priors=priors_of(group.unknown.prior for group in free),
        scale=locked([radian if g.unknown.property == "delay" else 0.0 for g in free], float),
        outputs=tuple(record.outputs),
        inputs=tuple(record.inputs),
        of_outputs=_members([group.outputs for group in free], n_out),
        of_inputs=_members([group.inputs for group in free], n_in),
        polarity_names=tuple(group.name for group in poles),
        polarity_outputs=_members([group.outputs for group in poles], n_out),
        polarity_inputs=_members([group.inputs for group in poles], n_in),
        polarities=locked(np.ones(len(poles))),
    )
    _require_ranges(free, made)
    return made


def _parameters_of(record: ChannelsOfRecord, unknown: ChannelUnknown) -> list[_Group]:
    """Parameters that the declaration `unknown` makes on channels of `record`: one for each channel, or one for all.

    A polarity, or a declaration with `each`, has one for each output, then for each input. Labels are the channels, or
    the declaration's `name`. Raises `InputError` if the property is unknown, no channel is named, or an option does not
    fit it.
    """
    if unknown.property not in (*_CONTINUOUS, "polarity"):
        known = ", ".join((*_CONTINUOUS, "polarity"))
        raise InputError(f"channel error `property` must be one of {known}, got {unknown.property!r}")
    outputs = _channel_indices("outputs", unknown.outputs, record.outputs)
    inputs = _channel_indices("inputs", unknown.inputs, record.inputs)
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


def _channel_indices(key: str, given: str | Sequence[str], channels: tuple[Dof, ...]) -> tuple[int, ...]:
    """Indices in `channels` of the degrees of freedom `given`, in either direction, each once; all for "all".

    They are in the order of `given`; `key` names the option in errors. Raises `InputError` if a channel is missing, or
    if several channels read the same degree of freedom.
    """
    texts = (given,) if isinstance(given, str) else tuple(given)
    if texts == (_ALL,):
        return tuple(range(len(channels)))
    unsigned = [dof.unsigned for dof in channels]
    indices = []
    for text in texts:
        dof = parse_dof(text).unsigned
        if dof not in unsigned:
            words = [str(channel) for channel in channels]
            near = difflib.get_close_matches(str(text), words, 1, 0.0)
            raise InputError(
                f"`{key}` must name channels of the record, got {text!r}"
                + (f"; the nearest is {near[0]}" if near else "")
            )
        if unsigned.count(dof) > 1:
            raise InputError(
                f"`{key}` names {text}, which several channels read; an error belongs to one of them alone"
            )
        indices.append(unsigned.index(dof))
    return tuple(dict.fromkeys(indices))


def _require_distinct(groups: list[_Group]) -> None:
    """Raise `InputError` if two parameters in `groups` share a name, or are the same property of the same channel.

    Decays of windows name no channel; two of them count as the same property of the same channel.
    """
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
    """Lower and upper bound of the parameter of `group`: the declared ones, or 0 to infinity, or no limits for a delay.

    Raises `InputError` if declared bounds do not increase, or are negative except for a delay.
    """
    if group.unknown.bounds is not None:
        low, high = group.unknown.bounds
        if not low < high or (group.unknown.property != "delay" and low < 0):
            raise InputError(f"bounds of {group.name} must increase, from 0 unless a delay, got {group.unknown.bounds}")
        return float(low), float(high)
    return (0.0, np.inf) if group.unknown.property != "delay" else (-np.inf, np.inf)


def _require_ranges(groups: list[_Group], errors: ChannelErrors) -> None:
    """Raise `InputError` if a start does not lie inside its bounds, or a prior is unsound or does not fit the bounds.

    A log-normal prior does not fit a negative lower bound. `groups` and the parameters of `errors` are in the same
    order.
    """
    rows = zip(groups, errors.names, errors.start, errors.transforms.lower, errors.transforms.upper, strict=True)
    for group, name, value, low, high in rows:
        prior = group.unknown.prior
        if not low < value < high:
            raise InputError(
                f"initial value of {name} must lie between {low:g} and {high:g}, got {value:g}; give another `start`"
            )
        if prior is not None and prior.problem:
            raise InputError(f"prior of {name} {prior.problem}")
        if prior is not None and prior.kind == "lognormal" and low < 0:
            raise InputError(f"{name} can be negative and takes no log-normal prior; give it `bounds` or a normal one")
