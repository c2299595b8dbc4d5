"""Plan of a test before it is run: predicted accuracy, and the most informative sensors, loads and lines."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, evenly_spaced_indices, require_finite
from structid.core.constraints import require_declared
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.fem import Friction, Structure
from structid.forward.fixed_values import append_fixed_factors
from structid.forward.frf.response import response
from structid.identification.record_fit import structure_modes
from structid.identification.setups.setup import require_sound_model
from structid.inversion.covariance import inverse_information
from structid.inversion.diagnostics.design import (
    effective_independence,
    exchanged,
    gains,
    greedy,
    ignorance,
    information_root,
    merit,
    optimal,
    relative_std,
)
from structid.inversion.diagnostics.identifiability import identifiability
from structid.inversion.fixed_values import tolerance_words
from structid.planning.planned import Plan, PlannedTest, PlanOptions, SmallestTest
from structid.records import FrfRecord
from structid.records.record import FrfKind
from structid.unknowns import Parameters
from structid.unknowns.tolerances import FixedProperty, Tolerances, fixed_properties

__all__ = ["Plan", "PlanOptions", "PlannedTest", "SmallestTest", "plan"]

_SHOWN_NEXT = 10
_MOST_ROUNDS, _MOST_STARTS = 10, 8
_FIRST_MODES = 40  # of a model that are looked at; more as long as all of them are in the band
_CHUNK_BYTES = 48_000_000
_LARGEST_BYTES = 1_500_000_000
#: Responses this small, as a part of the largest at their line, are rounding and are taken as noise.
_ROUNDING = 1e-9


_DEFAULT_SENSORS = 4


def plan(structure: Structure, unknown: Parameters, options: PlanOptions, tolerances: Tolerances | None = None) -> Plan:
    """Choose the most informative sensors, loads and lines of a test, with the predicted accuracy of each parameter.

    The information of a test is the sum over its lines, sensors and loads of what each value tells of the relative
    parameters (Udwadia 1994); sets are chosen by greedy addition and exchange (Fedorov 1972), sensors and loads in
    turn. The prediction holds at the initial values, for a right model and noise that is independent from value to
    value. No record is needed.

    Parameters
    ----------
    structure : Structure
        Model with its initial values.
    unknown : Parameters
        Parameters to be identified; their priors count as information.
    options : PlanOptions
        Candidates, numbers to choose, lines and noise.
    tolerances : Tolerances, optional
        Tolerances of fixed model values and of the calibration. Their contribution to each deviation is reported beside
        that of noise; sensors, loads and lines are chosen by noise alone.

    Returns
    -------
    Plan
        The chosen test beside the installed one, that of effective independence and that of all candidates; best lines
        and the smallest sufficient test only if the options ask for them.

    Raises
    ------
    InputError
        If a candidate is not part of the structure, more are asked for than there are, or there is no noise.
    SingularModelError
        If the initial model has a mechanism.

    References
    ----------
    Udwadia (1994), J. Eng. Mech. 120, 368-390; Fedorov (1972), Theory of Optimal Experiments; Kammer (1991), J.
    Guidance, Control, and Dynamics 14, 251-259.

    Examples
    --------
    >>> import numpy as np
    >>> from structid.unknowns import Unknown, parameters
    >>> from structid.fem import Beam, Structure
    >>> beam = Beam("beam", [[i, i + 1] for i in range(3)], mass=2.0, bending_stiffness=500.0)
    >>> cantilever = Structure({i: float(i) for i in range(4)}, [beam], fixed=["0Y", "0RZ"])
    >>> unknown = parameters(cantilever, [Unknown("bending_stiffness", "beam", each=True)])
    >>> found = plan(cantilever, unknown, PlanOptions(np.linspace(0.5, 40, 80), n_sensors=1, absolute_noise=1e-3))
    >>> str(found.chosen.loads[0]), found.determined
    ('2Y+', True)
    """
    options = resolve_options(structure, unknown, options)
    require_sound_model(structure, unknown.values(unknown.start), float(min(options.frequency)))
    selection = _prepare_selection(structure, unknown, options, tolerances or Tolerances())
    sensors, loads = _best_sensors_and_loads(selection)
    chosen = _at_all_lines(selection, "chosen", sensors, loads)
    installed = None
    if options.installed_sensors:
        there = positions(options.installed_loads, options.loads) or loads
        installed = _at_all_lines(selection, "installed", positions(options.installed_sensors, options.sensors), there)
    everything = _at_all_lines(selection, "all candidates", range(len(options.sensors)), range(len(options.loads)))
    needs_lines = options.n_frequencies is not None or options.target is not None
    lines, by_line = line_roots(selection.candidates, sensors, loads) if needs_lines else (None, None)
    selection = replace(selection, by_line=by_line)
    best, spread = _best_lines(selection, chosen, lines, options.n_frequencies)
    return Plan(
        structure=structure,
        parameters=unknown,
        options=options,
        installed=installed,
        chosen=chosen,
        kammer=_at_all_lines(selection, "effective independence", _kammer_sensors(selection, len(sensors)), loads)
        if structure.has_modes
        else None,
        everything=everything,
        frequencies=best,
        spread=spread,
        next_sensors=_next_sensors(selection, installed or chosen),
        enough=None
        if lines is None or options.target is None
        else _smallest_sufficient(selection, chosen, loads, lines),
        identifiability=identifiability(selection.rows(sensors, loads), unknown.start, unknown.names),
        assumption=tolerance_words(
            selection.candidates.fixed_names, selection.candidates.fixed_kinds, selection.candidates.tolerance.tolist()
        ),
    )


@dataclass(frozen=True, eq=False)
class _TestSelection:
    """All that a choice is made from.

    Attributes
    ----------
    candidates : Candidates
    options : PlanOptions
    pairs : (n_sensors, n_loads, n_params, n_params) float array
        See `pair_roots`.
    prior : (n_priors, n_params) float array
        Rows of the priors, by relative parameters.
    of_interest : (n_params,) bool array
    cross : (n_sensors, n_loads, n_params, n_fixed) float array
        J'J_h of each pair, J by relative parameters and J_h by relative fixed values.
    by_line : (n_lines, n_params, n_fixed) float array or None
        J'J_h of each line with the chosen sensors and loads; None where no lines are chosen.
    """

    candidates: Candidates
    options: PlanOptions
    pairs: FloatArray
    prior: FloatArray
    of_interest: np.ndarray
    cross: FloatArray
    by_line: FloatArray | None = None

    def deviations(self, rows: FloatArray, cross: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Relative standard deviations by noise and by tolerances of fixed values, (n_params,) each.

        By tolerances they are those of -(J'J + P)^-1 J'J_h dh, with P the information of the priors. A parameter
        that the test does not determine has NaN by noise, and 0 by tolerances. `rows` (n_rows, n_params) is the
        whitened Jacobian J of the test by relative changes; `cross` (n_params, n_fixed) is J'J_h, with J_h that of
        the fixed values.
        """
        known = np.vstack([rows, self.prior])
        bread = inverse_information(known)
        seen = np.isfinite(np.diag(bread))
        changes = np.zeros(cross.shape)
        changes[seen] = bread[np.ix_(seen, seen)] @ cross[seen] * self.candidates.tolerance
        return relative_std(known), np.linalg.norm(changes, axis=1)

    @property
    def known(self) -> FloatArray:
        """Information known before the test, (n_rows, n_params): the priors, and a very weak prior for every parameter."""
        return np.vstack([ignorance(self.pairs.shape[-1]), self.prior])

    def rows(self, sensors: tuple[int, ...] | range, loads: tuple[int, ...] | range) -> FloatArray:
        """Information root (n_rows, n_params) of the sensors and loads with these indices over all lines."""
        n_params = self.pairs.shape[-1]
        return information_root(self.pairs[np.ix_(list(sensors), list(loads))].reshape(-1, n_params))

    def by_sensor(self, loads: tuple[int, ...]) -> FloatArray:
        """Information root of each candidate sensor under the loads with these indices, (n_sensors, n_rows, n_params)."""
        n_sensors, _, _, n_params = self.pairs.shape
        return information_root(self.pairs[:, list(loads)].reshape(n_sensors, -1, n_params))

    def by_load(self, sensors: tuple[int, ...] | range) -> FloatArray:
        """Information root of each candidate load at the sensors with these indices, (n_loads, n_rows, n_params)."""
        _, n_loads, _, n_params = self.pairs.shape
        rows = np.swapaxes(self.pairs[list(sensors)], 0, 1).reshape(n_loads, -1, n_params)
        return information_root(rows)


def _prepare_selection(
    structure: Structure, unknown: Parameters, options: PlanOptions, tolerances: Tolerances
) -> _TestSelection:
    """Information of every pair of candidate sensor and load, and of the priors, at the initial values of `unknown`.

    It also has the mask of the parameters of interest, and products of parameters with fixed values that have one of
    `tolerances`.
    """
    fixed = fixed_properties(structure, unknown, tolerances) if structure.has_matrices else ()
    candidates = Candidates(
        structure,
        unknown,
        tuple(options.sensors),
        tuple(options.loads),
        np.asarray(options.frequency, dtype=np.float64),
        options.kind,
        options.relative_noise,
        options.absolute_noise,
        fixed,
        tolerances.calibration,
    )
    prior = unknown.prior_rows(unknown.start)[1] * candidates.scale
    pairs, cross = pair_roots(candidates)
    return _TestSelection(candidates, options, pairs, prior, wanted_parameters(unknown, options.of_interest), cross)


def _best_sensors_and_loads(selection: _TestSelection) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Indices of the sensors and of the loads of the most informative test, in this order, among the candidates.

    There are as many as the options ask for. Exchanges start from the best loads for all sensors, and from up to
    eight sets that each begin with one of the most informative loads; the best result by the options' criterion is
    taken. `selection` holds candidates, their information and the options.
    """
    options, known = selection.options, selection.known
    criterion = (options.criterion, selection.of_interest)
    by_load = selection.by_load(range(len(options.sensors)))
    count = options.n_loads or 1
    starts = [optimal(by_load, known, count, *criterion)]
    for load in np.argsort(-gains(by_load, known, *criterion), kind="stable")[:_MOST_STARTS].tolist():
        others = greedy(by_load, np.vstack([known, by_load[load]]), min(count, len(by_load)), *criterion)
        starts.append((load, *[i for i in others if i != load][: count - 1]))
    stable = {_exchange_until_stable(selection, start) for start in dict.fromkeys(starts)}
    return max(sorted(stable), key=lambda pair: merit(np.vstack([known, selection.rows(*pair)]), *criterion))


def _exchange_until_stable(
    selection: _TestSelection, loads: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Indices of sensors and of loads, improved in turn by exchanges until neither changes, in at most ten rounds.

    `loads` are the indices of the loads to begin with; the first sensors are the best for these. `selection` holds
    candidates, their information and the options.
    """
    options, known = selection.options, selection.known
    criterion = (options.criterion, selection.of_interest)
    sensors = optimal(selection.by_sensor(loads), known, options.n_sensors or 1, *criterion)
    for _ in range(_MOST_ROUNDS):
        better_loads = exchanged(selection.by_load(sensors), known, loads, *criterion)
        better_sensors = exchanged(selection.by_sensor(better_loads), known, sensors, *criterion)
        if (better_loads, better_sensors) == (loads, sensors):
            break
        loads, sensors = better_loads, better_sensors
    return sensors, loads


def _kammer_sensors(selection: _TestSelection, count: int) -> tuple[int, ...]:
    """Ascending indices of `count` candidate sensors, chosen by effective independence (Kammer) of modes in the band.

    At most `count` modes are used, the lowest of the band; without a mode in the band, the lowest of all. `selection`
    holds candidates, frequencies and the model.
    """
    structure, unknown, frequency = (
        selection.candidates.structure,
        selection.candidates.parameters,
        selection.candidates.frequency,
    )
    values, sought = unknown.values(unknown.start), max(_FIRST_MODES, count)
    modes = structure_modes(structure, values, min(sought, structure.n_dofs))
    while sought < structure.n_dofs and len(modes.frequency) == sought and modes.frequency[-1] <= frequency[-1]:
        sought *= 2
        modes = structure_modes(structure, values, min(sought, structure.n_dofs))
    inside = np.flatnonzero((modes.frequency >= frequency[0]) & (modes.frequency <= frequency[-1]))
    used = (inside if len(inside) else np.arange(len(modes.frequency)))[:count]
    shapes = structure.selection(selection.candidates.sensors).T @ modes.mode_shapes[:, used]
    return effective_independence(np.asarray(shapes), count)


def _at_all_lines(
    selection: _TestSelection, label: str, sensors: tuple[int, ...] | range, loads: tuple[int, ...] | range
) -> PlannedTest:
    """The test with the candidates `sensors` and `loads` (indices) at every line, with its predicted deviations.

    `label` names the test in tables.
    """
    options = selection.options
    cross = selection.cross[np.ix_(list(sensors), list(loads))].sum(axis=(0, 1))
    std, of_tolerances = selection.deviations(selection.rows(sensors, loads), cross)
    return PlannedTest(
        label,
        tuple(options.sensors[s] for s in sensors),
        tuple(options.loads[i] for i in loads),
        selection.candidates.frequency,
        std,
        selection.of_interest,
        of_tolerances,
    )


def _at_lines(
    selection: _TestSelection, test: PlannedTest, label: str, lines: FloatArray, chosen: tuple[int, ...]
) -> PlannedTest:
    """The test `test` reduced to some of its lines, with its predicted deviations.

    `label` names it in tables, `lines` (n_lines, n_rows, n_params) are roots R of the information R'R of each line, and
    `chosen` the indices of the lines to keep.
    """
    index = sorted(chosen)
    cross = np.zeros(selection.cross.shape[2:]) if selection.by_line is None else selection.by_line[index].sum(axis=0)
    std, of_tolerances = selection.deviations(lines[index].reshape(-1, lines.shape[-1]), cross)
    frequency = selection.candidates.frequency[index]
    return replace(test, label=label, frequency=frequency, std=std, of_tolerances=of_tolerances)


def _best_lines(
    selection: _TestSelection, chosen: PlannedTest, lines: FloatArray | None, count: int | None
) -> tuple[PlannedTest | None, PlannedTest | None]:
    """The test `chosen` at its `count` most informative lines, and at `count` evenly spaced lines.

    Both are None if `lines` or `count` is None, as they were not asked for. `lines` (n_lines, n_rows, n_params) are
    roots R of the information R'R of each line.
    """
    if lines is None or count is None:
        return None, None
    options = selection.options
    best = optimal(lines, selection.known, count, options.criterion, selection.of_interest)
    even = tuple(evenly_spaced_indices(len(lines), count).tolist())
    return (
        _at_lines(selection, chosen, f"chosen, best {count} lines", lines, best),
        _at_lines(selection, chosen, f"chosen, {len(even)} lines spread evenly", lines, even),
    )


def _next_sensors(selection: _TestSelection, start: PlannedTest) -> tuple[PlannedTest, ...]:
    """Tests that add one further candidate sensor to `start`, for at most ten sensors, that of most information first.

    Sensors that `start` has already are left out. `selection` holds candidates, their information and the options.
    """
    options = selection.options
    sensors, loads = positions(start.sensors, options.sensors), positions(start.loads, options.loads)
    known = np.vstack([selection.known, selection.rows(sensors, loads)])
    gain = gains(selection.by_sensor(loads), known, options.criterion, selection.of_interest)
    gain[list(sensors)] = -np.inf
    order = [int(i) for i in np.argsort(-gain, kind="stable") if np.isfinite(gain[i])][:_SHOWN_NEXT]
    return tuple(_at_all_lines(selection, f"{start.label} + {options.sensors[i]}", (*sensors, i), loads) for i in order)


def _smallest_sufficient(
    selection: _TestSelection, chosen: PlannedTest, loads: tuple[int, ...], lines: FloatArray
) -> SmallestTest:
    """Fewest sensors, fewest lines and the factor on averages that alone let the worst deviation reach the target.

    The target is the relative standard deviation `PlanOptions.target`, which must be set. Sensors (with `loads`,
    indices of candidates) and lines are added greedily; their tests are None if all candidates do not suffice. The
    factor is that by which `chosen` needs more averages, below 1 if it needs fewer. `lines` (n_lines, n_rows,
    n_params) are roots R of the information R'R of each line, with the sensors and loads of `chosen`.
    """
    target = float(selection.options.target or 0.0)

    def with_sensors(indices: tuple[int, ...]) -> PlannedTest:
        return _at_all_lines(selection, f"enough for {target:g}: sensors", indices, loads)

    def with_lines(indices: tuple[int, ...]) -> PlannedTest:
        return _at_lines(selection, chosen, f"enough for {target:g}: lines", lines, indices)

    return SmallestTest(
        target,
        _fewest_reaching(selection, selection.by_sensor(loads), with_sensors, target),
        _fewest_reaching(selection, lines, with_lines, target),
        (chosen.worst_std / target) ** 2,
    )


def _fewest_reaching(
    selection: _TestSelection,
    candidates: FloatArray,
    make_test: Callable[[tuple[int, ...]], PlannedTest],
    target: float,
) -> PlannedTest | None:
    """The test with the fewest candidates, added greedily, whose worst deviation is at most `target`.

    None if all candidates together do not reach it. `candidates` holds information roots (n_candidates, n_rows, n_params);
    `make_test` turns chosen indices into a test.
    """
    if make_test(tuple(range(len(candidates)))).worst_std > target:
        return None
    criterion, wanted = selection.options.criterion, selection.of_interest

    def reached(indices: tuple[int, ...]) -> bool:
        return make_test(indices).worst_std <= target

    return make_test(greedy(candidates, selection.known, len(candidates), criterion, wanted, reached))


@dataclass(frozen=True, eq=False)
class Candidates:
    """Every place and line that a test could use, and the noise it would have.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
        The derivatives are taken at their initial values.
    sensors, loads : tuple of Dof
    frequency : (n_lines,) float array
        Hz.
    kind : {"receptance", "mobility", "accelerance", "transmissibility"}
    relative_noise, absolute_noise : float
        Standard deviation of the complex noise: a part of each value's magnitude, and in the SI unit of `kind`,
        added in quadrature.
    fixed : tuple of FixedProperty
        Values that the model fixes within a tolerance.
    calibration : float
        Tolerance of the common gain.
    """

    structure: Structure
    parameters: Parameters
    sensors: tuple[Dof, ...]
    loads: tuple[Dof, ...]
    frequency: FloatArray
    kind: FrfKind
    relative_noise: float
    absolute_noise: float
    fixed: tuple[FixedProperty, ...] = ()
    calibration: float = 0.0

    @property
    def tolerance(self) -> FloatArray:
        """Tolerances of the fixed values and, where it has one, of the gain, (n_fixed,)."""
        return np.array([item.tolerance for item in self.fixed] + [self.calibration] * (self.calibration > 0))

    @property
    def fixed_names(self) -> tuple[str, ...]:
        """Name of each value that has an entry in `tolerance`."""
        return (*(item.label for item in self.fixed), *(("calibration",) if self.calibration > 0 else ()))

    @property
    def fixed_kinds(self) -> tuple[str, ...]:
        """Kind of each value that has an entry in `tolerance`, such as "gain" for the common gain."""
        return (*(item.kind for item in self.fixed), *(("gain",) if self.calibration > 0 else ()))

    @property
    def scale(self) -> FloatArray:
        """Size of each parameter, (n_params,), to which its standard deviation is relative: its start, or 1 for 0."""
        start = np.abs(self.parameters.start)
        return np.where(start > 0, start, 1.0)


def pair_roots(candidates: Candidates) -> tuple[FloatArray, FloatArray]:
    """Information of each pair of sensor and load over all lines: triangular roots, and products with fixed values.

    The roots R, with R'R = J'J, are (n_sensors, n_loads, n_params, n_params); the products J'J_h are (n_sensors,
    n_loads, n_params, n_fixed). J and J_h are the whitened Jacobians by relative changes of the parameters and of the
    fixed values. Lines are processed in chunks to save memory.

    Raises
    ------
    InputError
        If there are so many pairs that their triangles take more than 1.5 GB.
    """
    n_params, n_fixed = candidates.parameters.n_params, len(candidates.tolerance)
    size = 8 * len(candidates.sensors) * len(candidates.loads) * n_params * (n_params + n_fixed)
    if size > _LARGEST_BYTES:
        raise InputError(
            f"{len(candidates.sensors)} sensors times {len(candidates.loads)} loads with {n_params} parameters are too many"
            f" candidates ({size / 1e9:.1f} GB); name fewer in `sensors` and `loads`"
        )
    roots = np.zeros((len(candidates.sensors), len(candidates.loads), n_params, n_params))
    cross = np.zeros((len(candidates.sensors), len(candidates.loads), n_params, n_fixed))
    for loads, _, rows in _row_chunks(candidates, range(len(candidates.sensors)), range(len(candidates.loads))):
        n_lines = rows.shape[0]
        by_pair = np.moveaxis(rows, 0, 2).reshape(*rows.shape[1:3], n_lines * 2, n_params + n_fixed)
        stacked = np.concatenate([roots[:, loads], by_pair[..., :n_params]], axis=2)
        roots[:, loads] = np.linalg.qr(stacked, mode="r")
        cross[:, loads] += np.swapaxes(by_pair[..., :n_params], 2, 3) @ by_pair[..., n_params:]
    return roots, cross


def line_roots(
    candidates: Candidates, sensors: tuple[int, ...], loads: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Information of each line from the candidates `sensors` and `loads`, given by their indices.

    It is held in roots R, with R'R = J'J, (n_lines, n_rows, n_params), and products J'J_h, (n_lines, n_params,
    n_fixed). J and J_h are the whitened Jacobians by relative changes of the parameters and of the fixed values.
    """
    n_params, n_lines = candidates.parameters.n_params, len(candidates.frequency)
    parts: dict[int, list[FloatArray]] = {}
    for _, lines, rows in _row_chunks(candidates, sensors, loads):
        parts.setdefault(lines.start, []).append(rows.reshape(rows.shape[0], -1, rows.shape[-1]))
    whole = [np.concatenate(blocks, axis=1) for _, blocks in sorted(parts.items())]
    roots = [information_root(rows[..., :n_params]) for rows in whole]
    cross = [np.swapaxes(rows[..., :n_params], 1, 2) @ rows[..., n_params:] for rows in whole]
    return np.concatenate(roots).reshape(n_lines, -1, n_params), np.concatenate(cross)


def _row_chunks(
    candidates: Candidates, sensors: range | tuple[int, ...], loads: range | tuple[int, ...]
) -> Iterator[tuple[slice, slice, FloatArray]]:
    """Chunks of whitened sensitivities, each with the slice of `loads` and the slice of lines that it covers.

    A chunk is (n_lines, n_sensors, n_loads, 2, n_columns): real and imaginary parts, and columns of the parameters,
    then of the fixed values. `sensors` and `loads` are indices of candidates.
    """
    n_params, n_dofs = candidates.parameters.n_params + len(candidates.tolerance), candidates.structure.n_dofs
    has_friction = any(isinstance(element, Friction) for element in candidates.structure.elements)
    per_load = 16 * len(sensors) * n_params
    group = 1 if has_friction else max(1, _CHUNK_BYTES // max(per_load, 1))
    for first_load in range(0, len(loads), group):
        part = slice(first_load, min(first_load + group, len(loads)))
        chosen = tuple(loads)[part]
        per_line = max(per_load * len(chosen), 16 * n_dofs * (len(sensors) + len(chosen)))
        step = max(1, _CHUNK_BYTES // max(per_line, 1))
        for first in range(0, len(candidates.frequency), step):
            lines = slice(first, min(first + step, len(candidates.frequency)))
            yield part, lines, _whitened_sensitivities(candidates, tuple(sensors), chosen, lines)


def _whitened_sensitivities(
    candidates: Candidates, sensors: tuple[int, ...], loads: tuple[int, ...], lines: slice
) -> FloatArray:
    """Derivatives of the FRFs by relative changes over the noise, (n_lines, n_sensors, n_loads, 2, n_columns).

    The fourth axis has real and imaginary part; the last the parameters, the fixed properties, and a common gain if it has a
    tolerance. `sensors` and `loads` are indices of candidates, `lines` a slice of the frequencies.
    """
    frequency = candidates.frequency[lines]
    record = FrfRecord(
        frequency,
        np.zeros((len(frequency), len(sensors), len(loads)), dtype=np.complex128),
        tuple(candidates.sensors[s] for s in sensors),
        tuple(candidates.loads[i] for i in loads),
        candidates.kind,
    )
    parameters = (
        append_fixed_factors(candidates.parameters, candidates.fixed) if candidates.fixed else candidates.parameters
    )
    candidates.structure.require_masses("FRFs")
    values, derivative = response(candidates.structure, parameters, record).derivatives_at(parameters.start)
    std = _noise_deviation(candidates, values)
    # a value that nothing moves, at rest on the path of every load, has no noise either and tells nothing
    weight = np.divide(1.0, std, out=np.zeros_like(std), where=std > 0)
    scaled = derivative * np.concatenate([candidates.scale, np.ones(len(candidates.fixed))])
    if candidates.calibration > 0:
        scaled = np.concatenate([scaled, values[..., None]], axis=-1)
    rows = scaled * weight[..., None]
    return np.stack([rows.real, rows.imag], axis=3)


def _noise_deviation(candidates: Candidates, values: ComplexArray) -> FloatArray:
    """Standard deviation of the real (or imaginary) part of each FRF value, in the shape of `values`.

    `values` is (n_lines, n_sensors, n_loads). Relative and absolute noise of the candidates are added as squares,
    and half of the variance is taken for each part. A value below 1e-9 of the largest one of its line gets at least
    that largest one as noise.
    """
    size = np.abs(values)
    rounding = _ROUNDING * size.max(axis=(1, 2), keepdims=True)
    noise = np.hypot(candidates.relative_noise * size, candidates.absolute_noise)
    is_rounding = size < rounding
    return np.where(is_rounding, np.maximum(noise, size.max(axis=(1, 2), keepdims=True)), noise) / np.sqrt(2)


def resolve_options(structure: Structure, unknown: Parameters, options: PlanOptions) -> PlanOptions:
    """`options` with every default filled in (candidate sensors and loads, their numbers), after checks of all of them.

    By default, candidate sensors are all translations that move, candidate loads the installed ones, or without any the
    same translations (for transmissibility the driving supports). Installed ones are added to the candidates. As many
    are chosen as are installed, or else 4 sensors and 1 load.

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
    """Mask (n_params,) of the parameters that `wanted` names, by full name or by property.

    All True if `wanted` is empty.

    Raises
    ------
    InputError
        If a name matches no parameter; the nearest is named.
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
            f"`n_{name}`, or --{name}, must be from 1 to {available}, the number of candidates, got {wanted};"
            " ask for fewer or name more candidates"
        )
    return wanted
