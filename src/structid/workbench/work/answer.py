"""An identified structure as the page draws it: its changes by element, the shapes of its modes, and its responses."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from structid.core.display import number
from structid.core.dof import parse_dof
from structid.core.errors import FileError
from structid.core.json_types import StoredEntry
from structid.files.contained import hdf5_fields, texts_of
from structid.forward import FrfProblem, RecordProblem
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup
from structid.report.drawing.palette import steps
from structid.report.figures.responses import channel_unit
from structid.report.figures.structure import Change, IdentifiedParameters, Shading, element_style, parameter_shadings
from structid.study.results.stored_model import stored_model, stored_study
from structid.study.run.exports import model_modes, node_translations
from structid.study.schema.study import Study
from structid.workbench.folder import read_json
from structid.workbench.work.scene import packed, structure_scene

#: Modes whose shapes are sent, and degrees of freedom beyond which none are.
_MODES, _MOST_DOFS = 12, 30_000
#: Colours of the legend, and changes of an element set that are told in words.
_LEGEND_COLOURS, _MOST_WORDS = 9, 20
#: Lines of one channel that are sent of a model at most.
_MOST_LINES = 4000
_FIELDS = ("frequency", "measured", "predicted", "predicted_initial", "outputs", "inputs", "kind")
#: Values of all channels together that are sent at most.
_MOST_VALUES = 400_000


def identified_scene(folder: Path) -> dict[str, StoredEntry]:
    """Drawing data of an identified structure: that of `structure_scene`, with colours of its changes and up to 12 mode shapes.

    ``shadings`` are colourings of the elements with legends; ``modes`` hold a name and packed node displacements, and are empty
    above 30 000 degrees of freedom or without a modal model.

    Raises
    ------
    FileError
        If the folder is of another version, its study has changed, or its estimate.json cannot be used.
    NoAnswerError
        If the data do not determine the model.
    """
    study = stored_study(folder)
    structure = study.structure
    drawn: dict[str, StoredEntry] = structure_scene(structure)
    drawn["shadings"] = [_shading(one, study) for one in parameter_shadings(_identified_parameters(folder, study))]
    drawn["modes"] = []
    if structure.has_modes and structure.n_dofs <= _MOST_DOFS:
        computed = model_modes(stored_model(folder, study), _MODES)
        moves = node_translations(structure, computed.mode_shapes)
        drawn["modes"] = [
            {"name": f"mode {k + 1}: {number(float(frequency), 4)} Hz", "moves": packed(moves[k], np.float32)}
            for k, frequency in enumerate(computed.frequency)
        ]
    return drawn


def _identified_parameters(folder: Path, study: Study) -> IdentifiedParameters:
    """Parameters of a study with start and identified values and 95 % intervals, from estimate.json in `folder`.

    An end of an interval that is missing becomes infinite; raises `FileError` if the file cannot be used.
    """
    try:
        listed = {one["name"]: one for one in read_json(folder / "estimate.json")["parameters"]}
        entries = [listed[name] for name in study.parameters.names]
        ends = [one.get("interval_95") or (None, None) for one in entries]
        intervals = [[-np.inf if low is None else low, np.inf if high is None else high] for low, high in ends]
        return IdentifiedParameters(
            study.structure,
            study.parameters,
            np.array([one["initial"] for one in entries], dtype=float),
            np.array([one["value"] for one in entries], dtype=float),
            np.array([one["identified"] for one in entries], dtype=bool),
            np.array(intervals, dtype=float).reshape(-1, 2),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{folder / 'estimate.json'}: its parameters cannot be used; run the study again") from error


def _shading(shading: Shading, study: Study) -> dict[str, StoredEntry]:
    """Shading for the page: ``title``, ``legend`` (colours and tick labels), and ``sets`` by name of element set.

    A set holds its distinct ``colours``, the packed ``index`` of the colour of each element, and texts of its changes.
    `shading` has the changes of elements and their colours, `study` the element sets.
    """
    sets: dict[str, StoredEntry] = {}
    for element in study.structure.elements:
        rows = range(len(element.nodes))
        styles = [element_style(shading, element.name, row) for row in rows]
        colours = sorted({one.colour for one in styles})
        changes = [shading.changes.get((element.name, row)) for row in rows]
        sets[element.name] = {
            "colours": colours,
            "index": packed([colours.index(one.colour) for one in styles], np.uint8),
            "words": _largest_first(change for change in changes if change is not None),
        }
    scale = shading.scale
    return {
        "title": shading.title,
        "sets": sets,
        "legend": {"colours": steps(scale.colours, _LEGEND_COLOURS), "ticks": [words for _, words in scale.ticks]},
    }


def _largest_first(changes: Iterable[Change]) -> list[str]:
    """Distinct texts of the relative changes of an element set, the largest change first.

    At most 20; if there are more, a last text says how many were left out.
    """
    size = {change.text: abs(float(np.nan_to_num(change.ratio))) for change in changes}
    words = sorted(size, key=lambda text: (-size[text], text))
    more = len(words) - _MOST_WORDS
    return words if more <= 0 else [*words[:_MOST_WORDS], f"and {more} more"]


def fitted_responses(folder: Path) -> dict[str, StoredEntry]:
    """Measured, fitted and initial FRF magnitudes of every channel of the first record, largest misfit first.

    ``frequency`` (Hz), and ``channels`` with ``name``, ``quantity``, ``unit``, median relative ``error``, ``measured``,
    ``fitted`` and ``initial``; arrays are packed and thinned to about 400 000 values. If `folder` holds no FRFs,
    ``channels`` is empty, and there is no ``frequency``.

    Raises
    ------
    FileError
        If the responses in estimate.h5 cannot be used.
    """
    path = folder / "estimate.h5"
    if not path.is_file():
        return {"channels": []}
    fields = hdf5_fields(path, [f"frf/{name}" for name in _FIELDS])
    if "frf/frequency" not in fields:
        return {"channels": []}
    try:
        outputs, inputs = (texts_of(fields[f"frf/{name}"]) for name in ("outputs", "inputs"))
        frequency, kind = np.asarray(fields["frf/frequency"], dtype=float), texts_of(fields["frf/kind"])[0]
        shape = (len(frequency), len(outputs) * len(inputs))
        measured, fitted, initial = (np.asarray(fields[f"frf/{name}"]).reshape(shape) for name in _FIELDS[1:4])
    except (KeyError, ValueError) as error:
        raise FileError(f"{path}: its responses cannot be used; run the study again") from error
    size = np.maximum(np.abs(measured), np.finfo(float).tiny)
    errors = np.median(np.abs(fitted - measured) / size, axis=0)
    step = max(1, -(-3 * measured.size // _MOST_VALUES))
    pairs = [(output, load) for output in outputs for load in inputs]
    return {
        "frequency": packed(frequency[::step], np.float64),
        "channels": [
            {
                "name": "/".join(pairs[c]),
                "quantity": kind,
                "unit": channel_unit(kind, *map(parse_dof, pairs[c])),
                "error": float(errors[c]),
                "measured": packed(np.abs(measured[::step, c]), np.float32),
                "fitted": packed(np.abs(fitted[::step, c]), np.float32),
                "initial": packed(np.abs(initial[::step, c]), np.float32),
            }
            for c in np.argsort(-errors, kind="stable").tolist()
        ],
    }


def initial_responses(setup: AnySetup, problem: RecordProblem, options: IdentifyOptions) -> dict[str, StoredEntry]:
    """FRF magnitudes of a model at its start values, at the lines of its record, thinned to 4000 lines at most.

    ``frequency`` (Hz), and ``channels``, for each output and then each input, with ``name`` and ``magnitude``, packed.
    Histories count as averaged FRFs if the set-up gives any. If the record has no FRFs or the responses are not finite,
    ``channels`` is empty, and there is no ``frequency``. `options` say how they are averaged.
    """
    problem = setup.shown_problem(options, problem.channels) or problem
    if not isinstance(problem, FrfProblem):
        return {"channels": []}
    values, record = problem.predicted(problem.theta_start), problem.record
    if not np.isfinite(values).all():
        return {"channels": []}
    step = max(1, -(-len(record.frequency) // _MOST_LINES))
    return {
        "frequency": packed(record.frequency[::step], np.float64),
        "channels": [
            {"name": f"{output} / {load}", "magnitude": packed(np.abs(values[::step, o, i]), np.float32)}
            for o, output in enumerate(record.outputs)
            for i, load in enumerate(record.inputs)
        ],
    }
