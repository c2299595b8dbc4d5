"""Functions that the workbench calls in worker processes: its server stays small and outlives a broken file.

Every function takes the folder first and gives what JSON can hold.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from structid.core.errors import InputError, StructidError
from structid.workbench.folder import EXPORTS, OpenFolder
from structid.workbench.work.scene import LOOKING

if TYPE_CHECKING:  # NumPy comes with it, which the server does without
    from structid.core.json_types import StoredEntry

#: Of records that a worker keeps, so that a look at one does not read it anew.
_KEPT_BYTES = 500_000_000


def answer_json(name: str, root: str, arguments: dict[str, Any]) -> str:
    """JSON text that the worker function `name` answers, or ``{"error": message}`` if it fails.

    `root` is the path of the open folder, which the function takes first; `arguments` are its other arguments by name.
    """
    from structid.core.json_types import plain

    try:
        answer = _FUNCTIONS[name](OpenFolder(Path(root)), **arguments)
    except StructidError as error:
        answer = {"error": str(error).replace(f"{root}/", "")}
    except MemoryError:
        answer = {"error": "does not fit in memory; close other programs, or take a smaller part"}
    except (OSError, ArithmeticError, ValueError, LookupError) as error:
        answer = {"error": f"could not be computed ({type(error).__name__}: {error})"}
    return json.dumps(plain(answer), allow_nan=False, separators=(",", ":"))


def answer_keeping_records(name: str, root: str, arguments: dict[str, Any]) -> str:
    """JSON text as `answer_json` returns it, in a process that keeps up to 500 MB of the records that it has read.

    The next call on the same record then needs no second reading. `name` is the function, `root` the folder that is
    open, and `arguments` are the function's, by name.
    """
    from structid.records.formats import keep_records

    keep_records(_KEPT_BYTES)
    return answer_json(name, root, arguments)


def _warm(_: OpenFolder) -> StoredEntry:
    """Import the modules that the first requests need; the answer is empty."""
    import structid.workbench.work.scene
    import structid.workbench.work.signals  # noqa: F401

    return {}


def _scene(opened: OpenFolder, study: str, number: int = 0) -> StoredEntry:
    from structid.workbench.work.scene import scene

    return scene(opened.inside(study), number)


def _channels(opened: OpenFolder, study: str, number: int = 0) -> StoredEntry:
    """Channels of record `number` (from 0) of the study at the path `study`, with their nodes and directions.

    ``record`` lists the record's file names, of which the first is read; ``channels`` is as from `placed_channels`.
    `InputError` if that file is missing.
    """
    from structid.study.schema.tables import as_list
    from structid.workbench.work.scene import placed_channels, read_model, read_record_section
    from structid.workbench.work.signals import channels, options_of

    path = opened.inside(study)
    section = read_record_section(path, number)
    names = as_list(section.table.get("path") or section.table.get("repeats") or "")
    file = (path.parent / str(names[0])).resolve()
    if not file.is_file():
        raise InputError(f"the record {names} is not there; put it back, or choose another one on the start page")
    listed = channels(file, options_of(dict(section.table)))
    return {"record": names, "channels": placed_channels(read_model(path, number), listed)}


def _init(opened: OpenFolder, template: str, path: str, numbers: dict[str, Any]) -> StoredEntry:
    """Write a new study to `path` in the folder, and return ``{"path": path}``, with the suffix of a study added if missing.

    `template` is a name in `TEMPLATES`; `numbers` are the template's values by name. `InputError` if there is no such
    template.
    """
    from structid.study.templates import TEMPLATES, MeshTemplate, study_file, template_with, write_study

    path = str(study_file(Path(path)))
    if template not in TEMPLATES:
        raise InputError(f"there is no template {template!r}")
    made = template_with(TEMPLATES[template], numbers)
    if isinstance(made, MeshTemplate):  # the one that reads a file
        opened.inside(str(PurePosixPath(path).parent / made.path))
    write_study(made, opened.inside(path))
    return {"path": path}


def _kinds(_: OpenFolder) -> StoredEntry:
    from structid.workbench.work.scene import element_kinds

    return element_kinds()


def _mesh(opened: OpenFolder, path: str, length_unit: str) -> StoredEntry:
    from structid.workbench.work.scene import mesh_facts

    return mesh_facts(opened.inside(path), length_unit)


def _facts(opened: OpenFolder, record: str, options: dict[str, Any]) -> StoredEntry:
    from structid.workbench.work.signals import facts, options_of

    return facts(opened.inside(record), options_of(options))


def _histories(
    opened: OpenFolder, record: str, options: dict[str, Any], first: float, last: float | None, points: int
) -> StoredEntry:
    from structid.workbench.work.signals import histories, options_of

    overviews = opened.data_folder("overviews") if opened.is_writable else opened.root
    return histories(opened.inside(record), options_of(options), first, last, points, overviews)


def _overview(opened: OpenFolder, record: str, options: dict[str, Any]) -> StoredEntry:
    from structid.workbench.work.signals import options_of, write_overview

    write_overview(opened.inside(record), options_of(options), opened.data_folder("overviews"))
    return {}


def _responses(opened: OpenFolder, study: str, outputs: list[str], number: int = 0) -> StoredEntry:
    """Magnitude, phase and coherence of the FRF record of the study at the path `study`, with its bands (Hz).

    `outputs` are names of channels, all if empty; `number` counts the study's records from 0. The answer has ``band``,
    ``exclude`` (excluded bands) and the keys of `structid.workbench.work.signals.responses`: ``frequency`` (Hz),
    ``pairs``, packed arrays of each output and input, and what describes them. `InputError` if the record holds modes.
    """
    from structid.study.schema.method import read_method
    from structid.study.schema.records.record import load_record
    from structid.workbench.work.scene import read_record_source
    from structid.workbench.work.signals import responses

    root, source = read_record_source(opened.inside(study), number)
    if source.modes is not None:
        raise InputError("this record holds modes and no responses")
    method = read_method(root.section("method"))
    return {**responses(load_record(source), outputs), "band": method.band, "exclude": method.exclude}


def _check(opened: OpenFolder, study: str) -> StoredEntry:
    """Result of `structid check` for a study as a mapping: findings, channels, modes, parameters with predicted std, and rank.

    ``modes`` are rows of frequency (Hz), damping ratio, in band or not, and lines per half-power bandwidth; ``mass`` is the
    total mass and its standard deviation (kg). At most 2000 ``parameters``, of ``n_parameters``, and 12 undetermined
    ``directions`` are returned. The other keys mirror the result of `check_study`: ``determined``, ``records``,
    ``warnings``, ``findings``, ``facts``, ``channels``, ``rank`` and ``resonances``.
    """
    import numpy as np

    from structid.study.run.check import check_study
    from structid.study.schema.study import load_study
    from structid.workbench.work.scene import told_findings

    result = check_study(load_study(opened.inside(study), work=LOOKING))
    relative = result.std / np.where(result.sizes > 0, result.sizes, np.nan)
    rows = zip(result.names, result.units, result.start, result.std, relative, strict=True)
    return {
        "determined": result.determined,
        "records": result.records,
        "warnings": result.warnings,
        "findings": told_findings(result.study.structure, result.places),
        "facts": [
            *([f"mesh: {result.division}"] if result.division else []),
            *(one.title + fact for one in result.beside for fact in one.facts),
        ],
        "channels": [[one.channel, one.role, one.seen] for one in result.channels],
        "modes": [[m.frequency, m.damping_ratio, m.in_band, m.lines_per_bandwidth] for m in result.modes],
        "parameters": [
            {"name": name, "unit": unit, "start": start, "std": std, "relative": part}
            for name, unit, start, std, part in list(rows)[:2000]
        ],
        "n_parameters": len(result.names),
        "rank": result.identifiability.rank,
        "directions": [one.words for one in result.identifiability.directions[:12]],
        "mass": [result.total_mass, result.total_mass_std],
        "resonances": [
            [pair.measured, pair.model, pair.half_bandwidths, pair.mac]
            for one in result.beside
            for pair in one.resonances
        ],
    }


def _model_magnitudes(opened: OpenFolder, study: str, number: int = 0) -> StoredEntry:
    """FRF magnitudes of the study's model at its start values, at the used lines of record `number` (counted from 0).

    `study` is the path of the study. ``frequency`` (Hz) is packed and thinned where there are many lines; ``channels``
    are mappings of name and packed magnitude. For a record without FRFs, or responses that are not finite, ``channels``
    is empty and there is no ``frequency``.
    """
    from structid.study.run.start import prepare_study
    from structid.study.schema.study import load_study
    from structid.workbench.work.answer import initial_responses
    from structid.workbench.work.scene import require_record

    ready = prepare_study(load_study(opened.inside(study), work=LOOKING))
    require_record(len(ready.setups), number)
    return initial_responses(ready.setups[number], ready.problems[number], ready.study.options)


def _needs(opened: OpenFolder, study: str) -> StoredEntry:
    """Memory (bytes) and duration (s) that the identification of the study at the path `study` is expected to take.

    ``bytes`` is needed and ``free`` is available. The run takes ``seconds`` at least and ``most_seconds`` if causes of
    a misfit are sought, for ``causes_seconds``; an iteration takes ``iteration_seconds``. ``is_tried`` is True if the
    search was tried to its end.
    """
    from structid.study.run.resources import available_bytes, expected
    from structid.study.schema.study import load_study

    needs, duration = expected(load_study(opened.inside(study), work=LOOKING))
    return {
        "bytes": needs.bytes_needed,
        "free": available_bytes(),
        "iteration_seconds": needs.iteration_seconds,
        "seconds": duration.least,
        "most_seconds": duration.most,
        "causes_seconds": duration.causes,
        "is_tried": duration.is_tried,
    }


def _plan(opened: OpenFolder, study: str, sensors: int) -> StoredEntry:
    """Best positions for `sensors` sensors, and loads, of the test that the study at the path `study` plans.

    ``sensors`` and ``loads`` are names of degrees of freedom; ``parameters`` are mappings with ``name`` and
    ``relative``, the predicted standard deviation relative to the initial value.
    """
    from structid.study.schema.plan import load_plan, planned

    chosen = planned(load_plan(opened.inside(study), n_sensors=sensors, work=LOOKING))
    rows = zip(chosen.parameters.names, chosen.chosen.std, strict=True)
    return {
        "sensors": [str(dof) for dof in chosen.chosen.sensors],
        "loads": [str(dof) for dof in chosen.chosen.loads],
        "parameters": [{"name": name, "relative": std} for name, std in rows],
    }


def _survey(opened: OpenFolder, record: str, options: dict[str, Any], band: list[float] | None) -> StoredEntry:
    from structid.workbench.work.modes import survey
    from structid.workbench.work.signals import options_of

    return survey(opened.inside(record), options_of(options), band)


def _pick(
    opened: OpenFolder,
    record: str,
    options: dict[str, Any],
    frequencies: list[float],
    out: str,
    band: list[float] | None,
) -> StoredEntry:
    """Identify the modes at the chosen `frequencies` (Hz) of a record, and save them in the folder `out`.

    `options` say how the record is read, by names of `ReadOptions`; `band` is [low, high] in Hz or None for the default. The
    answer has the modes as the page shows them, and the ``path`` of the file of modes.
    """
    from structid.workbench.work.modes import save
    from structid.workbench.work.signals import options_of

    folder = opened.inside(out)
    return {**save(opened.inside(record), options_of(options), frequencies, folder, band), "path": f"{out}/modes.json"}


def _merge(
    opened: OpenFolder, records: list[str], options: dict[str, Any], out: str, band: list[float] | None
) -> StoredEntry:
    """Merge modes of several set-ups, and save them in the folder `out`.

    `records` are paths of records or of files of modes; `options` say how records are read, by names of `ReadOptions`; `band`
    is [low, high] in Hz or None for the default. The answer has the merged modes as the page shows them, and the ``path`` of the
    file of modes.
    """
    from structid.workbench.work.modes import merge
    from structid.workbench.work.signals import options_of

    paths = [opened.inside(record) for record in records]
    return {**merge(paths, options_of(options), opened.inside(out), band), "path": f"{out}/modes.json"}


def _modes_beside_model(
    opened: OpenFolder, study: str, number: int, measured: str | dict[str, Any], at: str
) -> StoredEntry:
    """Measured modes compared with those of a study's model: pairs, frequency differences, MAC and remarks.

    `number` counts the study's records from 0; `measured` is the path of a file of modes, or unsaved modes as the page sends
    them; `at` is a results folder whose values the model takes, "" for the start values.
    """
    from structid.modal.formats.files import read_modes
    from structid.workbench.work.modes import beside, posted_modes
    from structid.workbench.work.scene import read_model

    results = opened.inside(at) if at else None
    modes = read_modes(opened.inside(measured)) if isinstance(measured, str) else posted_modes(measured)
    return beside(read_model(opened.inside(study), number), modes, results)


def _fits(opened: OpenFolder, results: str) -> StoredEntry:
    from structid.workbench.work.answer import fitted_responses

    return fitted_responses(opened.inside(results))


def _identified(opened: OpenFolder, results: str) -> StoredEntry:
    from structid.workbench.work.answer import identified_scene

    return identified_scene(opened.inside(results))


def _use(opened: OpenFolder, results: str) -> StoredEntry:
    from structid.workbench.work.use import use_facts

    return use_facts(opened.inside(results))


def _predict(opened: OpenFolder, results: str, options: dict[str, Any], changes: list[dict[str, Any]]) -> StoredEntry:
    """Answer of `predict_use` for a results folder, with the file of the history in ``options``, if any."""
    from structid.workbench.work.use import predict_use

    history = opened.inside(options["history"]) if options.get("history") else None
    return predict_use(opened.inside(results), {**options, "history": history}, changes)


def _exports(opened: OpenFolder, results: str, kind: str, suffix: str, options: dict[str, Any]) -> StoredEntry:
    """Write files of an identified model into the folder ``<results>_exports``, and say what was written.

    The answer has ``lines``, messages for the user, and ``paths`` of the files in the open folder. `kind` and `suffix`
    choose the file, as listed under ``offers`` of `use_facts`; `options` are those of `export_use`.
    """
    from structid.workbench.work.use import export_use

    folder, out = opened.inside(results), opened.inside(f"{results}{EXPORTS}")
    lines, paths = export_use(folder, kind, suffix, options, out)
    return {
        "lines": [line.replace(f"{opened.root}/", "") for line in lines],
        "paths": [opened.name(path) for path in paths],
    }


def _solver(opened: OpenFolder, study: str) -> StoredEntry:
    """Solver command that the study at the path `study` runs, as a mapping; {} if it runs no solver. Nothing is run.

    Keys are ``command``, its ``words`` and ``inputs``, ``confirmation`` (digest that the user confirms) and ``folder``,
    that of the study in the open folder.
    """
    from structid.study.schema.model.solver import solver_command
    from structid.study.schema.section import read_root

    command = solver_command(*read_root(opened.inside(study), work=LOOKING))
    return {} if command is None else {**command._asdict(), "folder": opened.name(opened.inside(study).parent)}


def _line(opened: OpenFolder, study: str) -> StoredEntry:
    """Try to read the study or plan at the path `study` without a solver's run: {} if that succeeds.

    Else an `InputError` with file and line is raised. A file with ``[record]`` counts as a study, any other as a plan.
    """
    from structid.study.schema.plan import load_plan
    from structid.study.schema.section import read_root
    from structid.study.schema.study import load_study

    path = opened.inside(study)
    root, _ = read_root(path, work=LOOKING)
    if "record" in root.table:
        load_study(path, work=LOOKING)
    else:
        load_plan(path, work=LOOKING)
    return {}


_FUNCTIONS: dict[str, Callable[..., StoredEntry]] = {
    "warm": _warm,
    "scene": _scene,
    "channels": _channels,
    "init": _init,
    "kinds": _kinds,
    "mesh": _mesh,
    "facts": _facts,
    "histories": _histories,
    "overview": _overview,
    "responses": _responses,
    "check": _check,
    "modelled": _model_magnitudes,
    "needs": _needs,
    "plan": _plan,
    "survey": _survey,
    "pick": _pick,
    "merge": _merge,
    "beside": _modes_beside_model,
    "fits": _fits,
    "identified": _identified,
    "use": _use,
    "predict": _predict,
    "exports": _exports,
    "line": _line,
    "solver": _solver,
}
