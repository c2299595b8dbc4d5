"""The options of a plan with every default filled in, and what is wrong with them said at once."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from structid.core.arrays import require_finite
from structid.core.constraints import require_declared
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.fem import Friction, Structure
from structid.planning.planned import PlanOptions
from structid.unknowns import Parameters

_DEFAULT_SENSORS = 4


def resolve_options(structure: Structure, unknown: Parameters, options: PlanOptions) -> PlanOptions:
    """`options` with every default filled in (candidate sensors and loads, their numbers), after checks of all of them.

    By default, candidate sensors are all translations that move, candidate loads the installed ones, or without any the same
    translations (for transmissibility the driving supports). Installed ones are added to the candidates.

    Raises
    ------
    InputError
        If an option cannot be used; the message says which and why.
    """
    frequency = np.asarray(options.frequency, dtype=np.float64)
    _require_increasing(frequency)
    if not (options.relative_noise >= 0 and options.absolute_noise >= 0) or not (
        options.relative_noise + options.absolute_noise > 0
    ):
        raise InputError(
            f"`relative_noise` or `absolute_noise` must be greater than 0, got {options.relative_noise:g} and"
            f" {options.absolute_noise:g}; without noise every test is perfect"
        )
    if unknown.n_params == 0:
        raise InputError("`unknown` must hold at least one parameter, got none; declare what is to be identified")
    installed_sensors, installed_loads = parse_dofs(options.installed_sensors), parse_dofs(options.installed_loads)
    moving = sorted(
        dof.unsigned for dof in (*structure.dofs, *(dof for one in structure.reductions for dof in one.inside))
    )
    translations = tuple(dof for dof in moving if dof.node in structure.nodes and not dof.is_rotation)
    drivable = translations
    if options.kind == "transmissibility":
        drivable = tuple(base.supports[0] for base in structure.bases)
    sensors = _join_dofs(installed_sensors, parse_dofs(options.sensors) or translations)
    loads = _join_dofs(installed_loads, parse_dofs(options.loads) or (() if installed_loads else drivable))
    if not loads and options.kind == "transmissibility":
        raise InputError(
            "transmissibility is per motion of a support that drives the structure; add a [[structure.base]]"
        )
    for name, dofs in (("sensors", sensors), ("loads", loads)):
        if not dofs:
            raise InputError(f"`{name}` must name at least one place; the structure has no free translation")
        structure.require_dofs(dofs, name == "loads")
    n_sensors = _checked_count("sensors", options.n_sensors, len(installed_sensors) or _DEFAULT_SENSORS, len(sensors))
    n_loads = _checked_count("loads", options.n_loads, len(installed_loads) or 1, len(loads))
    if n_loads > 1 and any(isinstance(element, Friction) for element in structure.elements):
        raise InputError("`n_loads` must be 1 for a structure with friction, whose motion is not a sum over loads")
    if options.n_frequencies is not None:
        _checked_count("frequencies", options.n_frequencies, 0, len(frequency))
    wanted_parameters(unknown, options.of_interest)
    require_declared(options)
    return replace(
        options,
        frequency=tuple(float(f) for f in frequency),
        sensors=sensors,
        loads=loads,
        installed_sensors=installed_sensors,
        installed_loads=installed_loads,
        n_sensors=n_sensors,
        n_loads=n_loads,
    )


def wanted_parameters(unknown: Parameters, wanted: Sequence[str]) -> np.ndarray:
    """Mask (n_params,) of the parameters that `wanted` names, by full name or by property; all True if it is empty.

    Raises
    ------
    InputError
        If a name matches no parameter.
    """
    if not wanted:
        return np.ones(unknown.n_params, dtype=bool)
    properties = [name.split("[")[0] for name in unknown.names]
    mask = np.zeros(unknown.n_params, dtype=bool)
    for text in wanted:
        matches = [text in (name, kind) for name, kind in zip(unknown.names, properties, strict=True)]
        if not any(matches):
            nearest = difflib.get_close_matches(text, [*unknown.names, *properties], 1, 0.0)
            raise InputError(f"`of_interest` names {text!r}, which is no parameter; the nearest is {nearest[0]!r}")
        mask |= np.array(matches)
    return mask


def positions(wanted: Iterable[Dof], among: Sequence[Dof]) -> tuple[int, ...]:
    """Index in `among` of each degree of freedom in `wanted`, whatever its sense; `KeyError` if it is not there."""
    index_of = {dof.unsigned: i for i, dof in enumerate(among)}
    return tuple(index_of[dof.unsigned] for dof in wanted)


def _require_increasing(frequency: np.ndarray) -> None:
    """Raise `InputError` unless `frequency` is a finite, increasing, non-negative array (n_lines,)."""
    if frequency.ndim != 1 or frequency.size == 0:
        raise InputError(f"`frequency` must be a list of at least one line in Hz, got shape {frequency.shape}")
    require_finite("frequency", frequency)
    if frequency[0] < 0 or (np.diff(frequency) <= 0).any():
        raise InputError("`frequency` must increase and not be negative; sort the lines and remove repeated ones")


def _join_dofs(first: tuple[Dof, ...], others: tuple[Dof, ...]) -> tuple[Dof, ...]:
    """Degrees of freedom of both tuples without repetition, those of `others` first.

    Where both have a place and direction, the sense in `first` counts.
    """
    return tuple({dof.unsigned: dof for dof in (*others, *first)}.values())


def _checked_count(name: str, wanted: int | None, default: int, available: int) -> int:
    """Number of items to choose: `wanted`, or the smaller of `default` and `available` if it is None.

    `name` is the plural in the `InputError` if `wanted` is not from 1 to `available`.
    """
    if wanted is None:
        return min(default, available)
    if not 1 <= wanted <= available:
        raise InputError(
            f"number of {name} must be from 1 to {available}, the number of candidates, got {wanted};"
            f" ask for fewer or name more candidates"
        )
    return wanted
