"""The ``[plan]`` of a study file, and the study as a plan needs it: structure and unknowns, a record only if there is one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from structid.core.constraints import NotNegative
from structid.core.display import join_words
from structid.core.dof import Dof, parse_dofs, renamed
from structid.core.errors import SingularModelError
from structid.fem import Structure
from structid.fem.measuring_points import AimedSensor
from structid.identification.options import IdentifyOptions
from structid.identification.record_fit import structure_modes
from structid.identification.setups.frf import used_lines
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.planning.plan import plan, resolve_options
from structid.planning.planned import Plan, PlanOptions
from structid.records import FrfRecord
from structid.records.noise_floor import missing_floor
from structid.study.schema.method import read_method
from structid.study.schema.model.structure import read_structure, read_tolerances
from structid.study.schema.records.record import NoiseSource, declared_noise, load_record, read_source
from structid.study.schema.records.sensors import channel_names, is_load, used_names
from structid.study.schema.section import InputFiles, Section, read_root, record_sections, title_of
from structid.study.schema.tables import COUNT, NOISE_PART, NUMBERS, RANGE, Given, Key, as_list, choice, table_of
from structid.study.schema.unknowns import read_parameters
from structid.unknowns import Parameters
from structid.unknowns.tolerances import Tolerances

_DEFAULT_LINES = 400
_DEFAULT_NOISE = 0.01
_MODES_OF_BAND = 12
_NO_NOISE: tuple[str, ...] = (
    f"no noise is given: {100 * _DEFAULT_NOISE:g} % of each value is taken; give [plan.noise], with `absolute` for what the"
    " sensors add, or places where little moves look too good",
)
_LOADS = ("loads", "installed_loads")


@dataclass(frozen=True)
class PlanNoise:
    """``[plan.noise]``, of the record that is to come, added in quadrature."""

    relative: Annotated[float, NOISE_PART, "A part of each value's magnitude"] = 0.0
    absolute: Annotated[NotNegative, "In the SI unit of `kind`"] = 0.0


PLAN = table_of(PlanOptions, ("relative_noise", "absolute_noise")) | {
    "frequency": Key(NUMBERS, "Candidate lines, Hz, in place of `band`"),
    "band": Key(RANGE, "Of candidate lines, Hz"),
    "n_lines": Key(COUNT, "How many candidate lines", default=_DEFAULT_LINES),
    "spacing": Key(choice("linear", "log"), "Of candidate lines", default="linear"),
    "noise": Key(table_of(PlanNoise), "Noise of the record that is to come"),
}


@dataclass(frozen=True, eq=False)
class PlanStudy:
    """A study file as a plan reads it.

    Attributes
    ----------
    title : str
    structure : Structure
    parameters : Parameters
    options : PlanOptions
        With every default filled in.
    notes : tuple of str
        Where the options come from, in so far as ``[plan]`` does not give them.
    root : Section
        The whole file, for the place of errors.
    digests : mapping of str to str
        SHA-256 of the study file and of every file that it names.
    """

    title: str
    structure: Structure
    parameters: Parameters
    options: PlanOptions
    notes: tuple[str, ...]
    root: Section
    digests: Mapping[str, str]

    @property
    def text(self) -> str:
        """Text of the study file, word for word."""
        return self.root.source.text


def load_plan(path: str | Path, work: TaskExecutor = SERIAL, **changes: Any) -> PlanStudy:
    """The plan in the study file at `path`, with its structure, parameters, options and notes.

    `changes` are fields of `PlanOptions` that replace those of the file; `work` is the executor of a solver's runs. Neither
    ``[plan]`` nor ``[record]`` is needed. Where there is a record, its sensors, loads, lines, kind and noise are the defaults.

    Raises
    ------
    InputError
        If a file is missing or broken, a key is unknown or wrong, or the options cannot be used; with its place.
    """
    root, files = read_root(path, work=work)
    recorded = next(iter(record_sections(root)), None)
    section = root.inner("structure")
    structure = read_structure(section, files, record=recorded)
    unknown = read_parameters(root, structure)
    aimed = channel_names(structure)
    section = root.inner("plan")
    method = read_method(root.section("method"))
    record, declared, notes = _read_record(recorded, files, structure, aimed)
    with (root.section("plan") or root).located():
        options, option_notes = _read_options(section, structure, unknown, record, declared, method, aimed)
        options = resolve_options(structure, unknown, replace(options, **changes))
    notes = (*notes, *option_notes, *_describe_aimed_sensors(structure, options))
    return PlanStudy(title_of(root), structure, unknown, options, notes, root, files.digests)


def _describe_aimed_sensors(structure: Structure, options: PlanOptions) -> tuple[str, ...]:
    """At most two sentences: which sensors of ``[record.sensors]`` are candidates of the plan, and which are not.

    An empty tuple if the structure has no such sensors.
    """
    aimed = [tie for tie in structure.ties if isinstance(tie, AimedSensor)]
    candidates = {dof.unsigned for dof in (*options.sensors, *options.loads)}
    names = [
        f"{tie.channel} (called {tie.dof.place} here)" if tie.dof.place != tie.channel else tie.channel for tie in aimed
    ]
    used = [words for words, tie in zip(names, aimed, strict=True) if tie.dof.unsigned in candidates]
    others = [tie.channel for tie in aimed if tie.dof.unsigned not in candidates]
    candidate_words = (f"candidates along directions of [record.sensors]: {join_words(used)}",) if used else ()
    other_words = (
        f"no candidates: {join_words(others)} of [record.sensors]; name them in `sensors` of [plan] to choose from them"
    )
    return (*candidate_words, other_words) if others else candidate_words


def _read_record(
    section: Section | None, files: InputFiles, structure: Structure, aimed: Mapping[str, str]
) -> tuple[FrfRecord | None, NoiseSource, tuple[str, ...]]:
    """The FRF record that ``[record]`` describes, its declared noise, and notes; None in place of a record not usable yet.

    That is so without a section, without the record's file, or for measured modes. `aimed` gives the structure's names
    of aimed sensors.
    """
    if section is None:
        return None, NoiseSource(), ()
    names = [name for key in ("path", "repeats") for name in as_list(section.table.get(key, []))]
    missing = [name for name in names if not (section.source.path.parent / str(name)).exists()]
    if missing:
        return None, declared_noise(section), (f"the record {missing[0]} is not there yet: planned without it",)
    described = read_source(section, files, aimed, structure.base_supports)
    if described.modes is not None:
        return None, NoiseSource(), ("the record holds modes: planned without it",)
    record = load_record(described)
    note = (
        f"what [plan] does not give comes from the record (sensors: {len(record.outputs)}, loads: {len(record.inputs)})"
    )
    return record, described.noise, (note,)


def _read_options(
    section: Section,
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord | None,
    declared: NoiseSource,
    method: IdentifyOptions,
    aimed: Mapping[str, str],
) -> tuple[PlanOptions, tuple[str, ...]]:
    """Options of the plan with defaults from the record and from ``[method]``, and notes on them.

    `aimed` gives the structure's names of aimed sensors, `declared` the noise that the record's section states;
    `record` is None if the plan has none. `StudyError` if the structure lacks a sensor or load.
    """
    values = section.values(PLAN)
    frequency, line_notes = _candidate_lines(section, values, structure, unknown, record, method)
    relative, absolute, noise_notes = _noise_levels(section, record, declared, method.model_error)
    for key in ("sensors", "installed_sensors", *_LOADS):
        with section.located(key):
            values[key] = _in_structure(parse_dofs(as_list(values.get(key, []))), aimed, key in _LOADS)
            structure.require_dofs(values[key], key in _LOADS)
    if structure.driven([dof for key in _LOADS for dof in values[key]]):
        values.setdefault("kind", "transmissibility")
    if record is not None:
        values.setdefault("kind", record.kind)
        values["installed_sensors"] = values["installed_sensors"] or record.outputs
        values["installed_loads"] = values["installed_loads"] or record.inputs
    values["of_interest"] = tuple(as_list(values.get("of_interest", [])))
    return PlanOptions(frequency, **values, relative_noise=relative, absolute_noise=absolute), (
        *line_notes,
        *noise_notes,
    )


def _in_structure(dofs: tuple[Dof, ...], aimed: Mapping[str, str], are_loads: bool) -> tuple[Dof, ...]:
    """The channels `dofs` as degrees of freedom of the structure; those of aimed sensors get their names in `aimed`.

    `are_loads` is True if the channels are loads.
    """
    own = used_names({name: dof for name, dof in aimed.items() if is_load(name) == are_loads}, dofs)
    return renamed((), dofs, own)[1] if are_loads else renamed(dofs, (), own)[0]


def _candidate_lines(
    section: Section,
    values: Given,
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord | None,
    method: IdentifyOptions,
) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Candidate frequencies in Hz and notes: those of the plan, else those of the record, else spread over a band.

    Those of the record are taken unless the plan gives a band or a number of lines. The band is that of the plan, of
    ``[method]``, of the record, or else reaches over the modes of the model; 400 lines by default. The keys used here
    are removed from `values`. `record` is None if there is none. `StudyError` if the plan gives lines in two ways.
    """
    band, spacing = values.pop("band", None), values.pop("spacing", "linear")
    axis, count = values.pop("frequency", None), values.pop("n_lines", None)
    if axis is not None:
        if band is not None or count is not None:
            raise section.error("gives lines both by `frequency` and by `band` or `n_lines`; keep one of them")
        return tuple(float(f) for f in as_list(axis)), ()
    if record is not None and band is None and count is None:
        return tuple(used_lines(record, method).frequency.tolist()), ()
    notes: tuple[str, ...] = ()
    band = band or method.band
    if band is None and record is not None:
        band = (float(record.frequency[0]), float(record.frequency[-1]))
    if band is None:
        band = _band_of_modes(structure, unknown)
        notes = (
            f"no band is given: from half the first to 1.2 times the last mode counted, {band[0]:.4g} to {band[1]:.4g} Hz",
        )
    low, high = float(band[0]), float(band[1])
    if low < 0 or (spacing == "log" and low <= 0):
        raise section.error(f"must begin above 0 Hz for this spacing, got {low:g}", "band")
    points = np.geomspace if spacing == "log" else np.linspace
    return tuple(points(low, high, count or _DEFAULT_LINES).tolist()), notes


def _band_of_modes(structure: Structure, unknown: Parameters) -> tuple[float, float]:
    frequency = structure_modes(structure, unknown.values(unknown.start), _MODES_OF_BAND).frequency
    flexible = frequency[frequency > 1e-4 * frequency.max(initial=0.0)]
    return float(0.5 * flexible.min(initial=1.0)), float(1.2 * flexible.max(initial=1.0))


def _noise_levels(
    section: Section, record: FrfRecord | None, declared: NoiseSource, model_error: float
) -> tuple[float, float, tuple[str, ...]]:
    """Relative noise, absolute noise (in the unit of the FRFs) and notes on where they come from.

    They are stated in the plan, else declared for the record, else the record's median, else 1 %. If the plan states
    none and the record has variances, a noise floor that these miss is added to the absolute noise. `model_error`
    (relative) is added to the relative noise, as squares, and stands alone where no noise is given. `record` may be
    None.
    """
    inner = section.section("noise")
    relative, absolute, notes = _DEFAULT_NOISE, 0.0, _NO_NOISE
    if inner is not None:
        declared_here = inner.read(PlanNoise)
        if declared_here.relative + declared_here.absolute == 0:
            raise inner.error("needs `relative` or `absolute` greater than 0")
        relative, absolute, notes = declared_here.relative, declared_here.absolute, ()
    elif declared.relative + declared.absolute > 0:
        relative, absolute, notes = declared.relative, declared.absolute, ()
    elif record is not None and record.variance is not None:
        size, std = np.abs(record.values), np.sqrt(record.variance)
        clear = std < size if (std < size).any() else size > 0
        relative = float(np.median(std[clear] / size[clear]))
        notes = (f"the noise is the median of the record, {100 * relative:.2g} %",)
        if not clear.all():
            notes = (
                f"{notes[0]}, over the {100 * clear.mean():.0f} % of its values above their noise; the others are taken to be as"
                " good in the next test: `band` leaves them out",
            )
    elif model_error > 0:
        relative, notes = 0.0, ("no noise is given beside the model error",)
    if inner is None and record is not None and record.variance is not None:
        floor = missing_floor(record, 0.0, is_assumed=False)
        if floor.any():
            shown = float(np.median(floor[floor > 0]))
            absolute = float(np.hypot(absolute, shown))
            notes = (
                *notes,
                f"the record shows a noise floor of {shown:.2g} {record.unit} between its resonances, which is added",
            )
    if model_error > 0:
        relative = float(np.hypot(relative, model_error))
        notes = (*notes, f"the model error of [method], {100 * model_error:.3g} %, counts as noise")
    return relative, absolute, notes


def _tolerances(root: Section) -> Tolerances:
    """Tolerances of fixed values that the study `root` states, with the calibration of its first record, if any."""
    tolerances = read_tolerances(root.inner("structure"))
    recorded = next(iter(record_sections(root)), None)
    stated = None if recorded is None else recorded.table.get("calibration")
    return replace(tolerances, calibration=float(stated)) if isinstance(stated, int | float) else tolerances


def planned(study: PlanStudy) -> Plan:
    """The test plan computed from the structure, parameters and options of `study`.

    Raises
    ------
    StudyError, SingularModelError
        If it cannot be made; with the place in the file.
    """
    try:
        with (study.root.section("plan") or study.root).located():
            return plan(study.structure, study.parameters, study.options, _tolerances(study.root))
    except SingularModelError as error:
        section = study.root.section("structure") or study.root
        raise SingularModelError(str(section.error(str(error)))) from error
