"""What a study can be expected to give, from its record and its initial model, before any search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import FloatArray
from structid.dof import Dof
from structid.estimation import Identifiability
from structid.estimation.covariance import inverse_information
from structid.estimation.diagnostics.identifiability import identifiability
from structid.estimation.estimate import relative_jacobian
from structid.estimation.problem import Linearization, Problem, parameter_sizes
from structid.identification.identified import AnySetup
from structid.identification.identify import titles
from structid.identification.model_modes import rounding_warnings, structure_modes
from structid.identification.ratios import common_scale, scale_words
from structid.identification.regularizing import coupled
from structid.identification.search import RecordProblem, by_name, together
from structid.identification.time_fit import target
from structid.modal import ModalRecord
from structid.observation import ModalProblem
from structid.records import FrfRecord
from structid.structure import Structure
from structid.structure.mesh_point import MeshPoint
from structid.study.run.free_check import FreePrediction, free_prediction
from structid.study.run.run import Start, is_free, started
from structid.study.schema.study import Study
from structid.unknowns import Smoothness, Sparsity, penalty, term_name

_MOST_DIRECTIONS = 12


@dataclass(frozen=True)
class ChannelCheck:
    """One sensor or load of the record, and the free degrees of freedom of the structure that it sees.

    Attributes
    ----------
    channel : str
        As the record names it.
    role : str
        ``output`` or ``input``.
    seen : str
        Free degrees of freedom with their coefficients, through rigid links and constraints.
    """

    channel: str
    role: str
    seen: str


@dataclass(frozen=True)
class ModeCheck:
    """One mode of the initial model, and how well the record's lines resolve it.

    Attributes
    ----------
    frequency, damping_ratio : float
        Hz, and 1.
    in_band : bool
    lines_per_bandwidth : float
        Half-power bandwidth (2 damping ratio frequency) over the line spacing there; below about 4 a resonance is
        poorly resolved, 0 for an undamped mode, and NaN where modes were measured.
    rounding : float
        Relative error of the frequency by rounding of the stiffness matrix.
    """

    frequency: float
    damping_ratio: float
    in_band: bool
    lines_per_bandwidth: float
    rounding: float


@dataclass(frozen=True, eq=False)
class CheckResult:
    """What `check_study` found.

    Attributes
    ----------
    study : Study
    record : FrfRecord or None
        The lines in the band, of the first record of responses.
    n_lines_total : int
        Lines of the whole record.
    modes_used : tuple of ModalRecord
        The records of modes.
    channels : tuple of ChannelCheck
    modes : tuple of ModeCheck
        Of the first set-up.
    identifiability : Identifiability or None
        Rank, condition and undetermined directions at the initial values, from the data alone; None where the
        parameters are too many for a Jacobian.
    free : FreePrediction or None
        What takes its place there.
    names, units : tuple of str
        Of the parameters of the structure, then those of the records' channels.
    start, sizes : (n_params,) float arrays
        Initial value of each, and what its standard deviation is held against.
    std : (n_params,) float array
        Predicted standard deviation of each parameter: the Cramer-Rao bound at the initial values, with the noise
        (and model error) of the study, its priors and regularizations of given strength; NaN where the data do not
        determine it.
    total_mass, total_mass_std : float
        Of the initial model, kg, and predicted.
    warnings : tuple of str
    """

    study: Study
    record: FrfRecord | None
    n_lines_total: int
    modes_used: tuple[ModalRecord, ...]
    channels: tuple[ChannelCheck, ...]
    modes: tuple[ModeCheck, ...]
    identifiability: Identifiability | None
    free: FreePrediction | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    start: FloatArray
    sizes: FloatArray
    std: FloatArray
    total_mass: float
    total_mass_std: float
    warnings: tuple[str, ...]

    @property
    def determined(self) -> bool:
        """Whether data and priors determine every parameter to better than its own size."""
        return bool((self.std <= self.sizes).all())


def check_study(study: Study) -> CheckResult:
    """All of the study read and its predicted accuracy; nothing is estimated.

    Raises
    ------
    InputError, SingularModelError
        As `run_study` would.
    """
    ready = started(study)
    free = free_prediction(ready) if is_free(ready) else None
    predicted = _free_part(ready, free) if free is not None else _dense_part(ready)
    problem, names = predicted.problem, predicted.problem.names
    start = by_name(names, ready.problems, "start")
    checked = [_modes(setup, part, study.options.n_modes) for setup, part in _pairs(ready)]
    titled = [f"{title}: " if len(checked) > 1 else "" for title in titles(ready.setups)]
    return CheckResult(
        study=study,
        record=ready.used,
        n_lines_total=0 if ready.record is None else len(ready.record.frequency),
        modes_used=tuple(part.record for part in ready.problems if isinstance(part, ModalProblem)),
        channels=tuple(
            replace(channel, channel=name + channel.channel)
            for name, (setup, part) in zip(titled, _pairs(ready), strict=True)
            for channel in _channels(setup.structure, part.record)
        ),
        modes=checked[0],
        identifiability=predicted.identifiability,
        free=free,
        names=names,
        units=problem.units,
        start=start,
        sizes=parameter_sizes(problem, start),
        std=predicted.std,
        total_mass=study.structure.mass_of(_start_values(study), study.options.direction),
        total_mass_std=predicted.total_mass_std,
        warnings=(
            *ready.unit_warnings,
            *ready.warnings,
            *(
                name + words
                for name, modes, (_, part) in zip(titled, checked, _pairs(ready), strict=True)
                for words in [
                    *rounding_warnings(np.array([mode.rounding for mode in modes])),
                    *([] if isinstance(part, ModalProblem) else _mode_warnings(modes)),
                ]
            ),
            *predicted.warnings,
        ),
    )


@dataclass(frozen=True, eq=False)
class _Predicted:
    """What a linearization at the initial values tells."""

    problem: Problem
    std: FloatArray
    total_mass_std: float
    warnings: tuple[str, ...]
    identifiability: Identifiability | None = None


def _dense_part(ready: Start) -> _Predicted:
    study = ready.study
    first = ready.problems[0]
    given = [
        penalty(first.structure, first.parameters, term).scaled(term.strength)
        for term in study.options.regularization
        if isinstance(term, Smoothness) and not isinstance(term.strength, str)
    ]
    problem = target(coupled(ready.problems, given), [s.time for s in ready.setups], study.options.exclude)
    theta = np.asarray(problem.theta_start)
    at = problem.linearize(theta)
    covariance = cramer_rao_bound(problem, at)
    std = np.sqrt(np.diag(covariance))
    relative = relative_jacobian(problem, theta, at)
    found = identifiability(relative, problem.physical(theta), problem.names)
    gradient = _mass_gradient(study)
    place = {name: k for k, name in enumerate(problem.names)}
    own = np.array([place[name] for name in study.parameters.names], dtype=int)[gradient != 0]
    used = gradient[gradient != 0]
    warnings: list[str] = []
    if any(isinstance(part, ModalProblem) for part in ready.problems):
        warnings += _ratio_warnings(problem, relative, std <= parameter_sizes(problem, problem.physical(theta)))
    warnings += [*_direction_warnings(found), *_regularization_warnings(study)]
    mass_std = float(np.sqrt(used @ covariance[np.ix_(own, own)] @ used))
    return _Predicted(problem, std, mass_std, tuple(warnings), found)


def _free_part(ready: Start, free: FreePrediction) -> _Predicted:
    problem = together(ready.problems)
    start = problem.physical(np.asarray(problem.theta_start))
    known = 0.0 if not _mass_gradient(ready.study).any() else float("nan")
    return _Predicted(problem, free.relative_std * np.abs(start), known, free.words)


def _start_values(study: Study) -> FloatArray:
    return study.parameters.values(study.parameters.start)


def _mass_gradient(study: Study) -> FloatArray:
    gradient = study.structure.mass_gradient(study.options.direction, _start_values(study))
    return np.asarray(gradient @ study.parameters.design)


def _pairs(ready: Start) -> list[tuple[AnySetup, RecordProblem]]:
    return list(zip(ready.setups, ready.problems, strict=True))


def cramer_rao_bound(problem: Problem, at: Linearization) -> FloatArray:
    """Smallest covariance that an unbiased estimate can have, (n_params, n_params), physical units.

    (J'J)^-1 of the whitened Jacobian J with respect to the physical parameters, priors counted as data.
    """
    slope = problem.slope(np.asarray(problem.theta_start))
    return inverse_information(at.jacobian) * np.outer(slope, slope)


def _channels(structure: Structure, record: FrfRecord | ModalRecord) -> tuple[ChannelCheck, ...]:
    if isinstance(record, ModalRecord):
        roles: tuple[tuple[str, tuple[Dof, ...]], ...] = (("output", record.channels),)
    else:
        roles = ("output", record.outputs), ("input", record.inputs)
    found = []
    for role, dofs in roles:
        columns = structure.selection(dofs).tocsc()
        for j, dof in enumerate(dofs):
            part = columns[:, [j]].tocoo()
            pairs = zip(part.coords[0], part.data, strict=True)
            terms = [f"{value:+.3g} {structure.dofs[int(row)].unsigned}"[:-1] for row, value in pairs]
            place = next((tie for tie in structure.ties if isinstance(tie, MeshPoint) and tie.label == dof.node), None)
            terms += [] if place is None else [f"(nearest node, {place.distance:.3g} m away)"]
            found.append(ChannelCheck(str(dof), role, " ".join(terms)))
    return tuple(found)


def _modes(setup: AnySetup, problem: RecordProblem, n_modes: int) -> tuple[ModeCheck, ...]:
    values = setup.parameters.values(setup.parameters.start)
    found = structure_modes(setup.structure, values, n_modes)
    axis = problem.record.frequency
    checks = []
    known = list(zip(found.frequency.tolist(), found.damping_ratio.tolist(), found.rounding.tolist(), strict=True))
    if isinstance(problem, ModalProblem):
        return tuple(ModeCheck(f, ratio, bool(axis[0] <= f <= axis[-1]), np.nan, error) for f, ratio, error in known)
    for frequency, ratio, error in known:
        near = int(np.clip(np.searchsorted(axis, frequency), 1, max(len(axis) - 1, 1)))
        spacing = float(axis[near] - axis[near - 1]) if len(axis) > 1 else np.inf
        inside = bool(axis[0] <= frequency <= axis[-1])
        checks.append(ModeCheck(frequency, ratio, inside, 2 * ratio * frequency / spacing, error))
    return tuple(checks)


def _mode_warnings(modes: tuple[ModeCheck, ...]) -> list[str]:
    if not any(mode.in_band for mode in modes):
        return ["no mode of the initial model lies in the band: damping cannot be told from it; check band and model"]
    coarse = [mode for mode in modes if mode.in_band and 0 < mode.lines_per_bandwidth < 1]
    return [
        f"the mode at {mode.frequency:.4g} Hz has {mode.lines_per_bandwidth:.2g} lines in its half-power bandwidth;"
        " measure with a finer frequency spacing to tell its damping"
        for mode in coarse
    ]


def _regularization_warnings(study: Study) -> list[str]:
    terms = " and ".join(
        term_name(term)
        for term in study.options.regularization
        if isinstance(term, Sparsity) or isinstance(term.strength, str)
    )
    return [f"predicted without the {terms} that `identify` will use"] if terms else []


def _ratio_warnings(problem: Problem, jacobian: FloatArray, identified: np.ndarray) -> list[str]:
    """That modes alone give no kilograms, where they do not."""
    members = common_scale(jacobian, np.array(problem.kinds))
    if members is None or identified[members].any():
        return []
    return [scale_words([problem.names[i] for i in members])]


def _direction_warnings(found: Identifiability) -> list[str]:
    """Those that are seen least, where there are many."""
    told = [f"the data determine {direction.words}" for direction in found.directions[:_MOST_DIRECTIONS]]
    more = len(found.directions) - len(told)
    return [*told, f"and {more} more combinations that the data do not determine"] if more else told
