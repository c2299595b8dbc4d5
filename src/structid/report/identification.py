"""The report of an identification: one page that needs no network."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.display import NOTHING, number, percent, plural, with_std, with_unit
from structid.diagnose.fixed_value_influence import FixedValueSensitivity, resting
from structid.diagnose.verdict import Cause, Diagnosis
from structid.identification.identified import Identification
from structid.inversion import Status
from structid.report import identification_tables as tables
from structid.report.correlation import side_by_side_chapter
from structid.report.drawing import palette
from structid.report.drawing.drawing import structure_picture
from structid.report.drawing.picture import Picture
from structid.report.figures.parameters import (
    band_used,
    convergence_figure,
    correlation_figure,
    modal_fit_figure,
    mode_rows,
    modes_figure,
    parameters_figure,
)
from structid.report.figures.responses import (
    extremes_figure,
    residual_channels_figure,
    residual_map_figure,
    responses_figure,
)
from structid.report.figures.side_by_side import model_shapes_figure
from structid.report.figures.structure import Change, Shading, round_limit, shading, shadings, structure_figure
from structid.report.identification_tables import modal_cards, modal_facts, modal_table, mode_table, ratio_table
from structid.report.page import Page, Table, provenance_table
from structid.report.rendering import plot
from structid.study.results.view import MOST_ADVICE, ResultsView, largest_changes, results_view, search_reason

if TYPE_CHECKING:
    from structid.study.results.result import StudyResult

#: Endings that introduce a warning which repeats what the table of parameters says for each parameter.
_REPEATED = re.compile(r"is not identified: (at the initial values )?its standard deviation is larger than its value$")
_MOST_REPEATED, _MOST_GROUPS = 4, 8
_MARKS = {"sound": "good", "approximate": "doubt", "wrong_model": "bad", "undetermined": "bad", "untested": "bad"}
_FIXED_VALUE_COLUMNS = (
    "Fixed value",
    "Parameter that 1 % more of it moves most",
    "by",
    "in standard deviations",
    "The record would change it by",
)
#: Standard deviations by which 1 % of a fixed value moves a parameter from where on the page lists it.
_TELLING = 0.1
_CAUSE_COLUMNS = (
    "Cause",
    "Misfit removed",
    "Chi-square per degree of freedom left",
    "What it adds",
    "Value that moves most",
)
_MOST_CHANGES = 25
_CHANGE_COLUMNS = ("Parameter", "Initial", "Identified", "Change", "Change in standard deviations")


def write_report(
    identification: Identification,
    folder: Path,
    title: str = "",
    provenance: Mapping[str, object] | None = None,
    png: bool = False,
    diagnosis: Diagnosis | None = None,
) -> Path:
    """Write the report page of an identification, ``report.html``, into `folder`, and return its path.

    Parameters
    ----------
    identification : Identification
        Result to report; also if the search failed or the parameters are not determined.
    folder : Path
        Created if missing. Files of the same names are replaced, each whole or not at all.
    title : str
        Heading of the page.
    provenance : mapping, optional
        Versions, digests of input files, settings: shown as they are at the end.
    png : bool
        True to write the figures as PNG files too, into ``figures``.
    diagnosis : Diagnosis, optional
        Verdict and possible causes of a misfit; without it the verdict is made here.

    Returns
    -------
    Path
        The page. The same identification gives the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    return report_page(identification, title, provenance, diagnosis).write(folder, png)


def report_page(
    identification: Identification,
    title: str = "",
    provenance: Mapping[str, object] | None = None,
    diagnosis: Diagnosis | None = None,
) -> Page:
    """Report page of an identification, with its figures; nothing is written.

    `provenance` has versions, digests and settings for a table; without a diagnosis the verdict is made here, and no
    causes are shown. An empty `title` becomes "Structural identification".
    """
    view = results_view(identification, diagnosis, title or "Structural identification", provenance)
    found, structure = identification.estimate, identification.structure
    drawn = structure_picture(structure, identification.sensors, identification.loads)
    band = band_used(identification.fits[:1], identification.modal_fits)
    rows = mode_rows(identification)
    n_records = len(identification.fits) + len(identification.modal_fits)
    warnings, repeated = sorted_warnings(identification)
    side_by_side, beside_model = side_by_side_chapter(identification)
    figures = {
        **({"extremes": extremes_figure(identification.fits[0])} if identification.fits else {}),
        "parameters": parameters_figure(identification),
        "structure": structure_figure(drawn, shadings(identification)),
        **_record_figures(identification),
        **{f"modal_fit_{k}": modal_fit_figure(fit) for k, fit in enumerate(identification.modal_fits, 1)},
        **side_by_side,
        "correlation": correlation_figure(identification),
        **({"modes": modes_figure(rows, band)} if len(rows.frequency) else {}),
        "convergence": convergence_figure(identification),
    }
    shapes = model_shapes_figure(structure, identification.modes)
    figures |= {} if shapes is None else {"shapes": shapes}
    words = {
        "title": view.title,
        **verdict_words(view),
        "values": tables.value_table(view),
        "status": found.status.value,
        "status_words": _status_warning(identification),
        "warnings": warnings,
        "repeated": repeated,
        "directions": tables.direction_table(found),
        "groups": [group.words for group in found.identifiability.groups[:_MOST_GROUPS]],
        "summary": (*tables.summary_facts(identification), *modal_cards(identification)),
        "record": tables.record_facts(identification) if identification.fits else (),
        "modal": [_modal(identification, index) for index in range(len(identification.modal_fits))],
        "ratios": ratio_table(identification),
        "structure": (
            *tables.structure_facts(structure),
            *(("Error of reduction", one.words) for one in identification.truncations),
        ),
        "elements": tables.element_table(structure),
        "parameters": tables.parameter_table(view),
        "alternatives": None
        if identification.alternatives is None
        else (identification.alternatives.search_words, tables.alternatives_table(identification.alternatives)),
        "varied": [
            (one.words, one.outlying_words, tables.varied_table(identification, one))
            for one in identification.priors.varied
        ],
        "intervals": tables.interval_words(identification),
        "interval_notes": view.notes,
        "residual_tests": tables.residual_table(found),
        "residual_words": () if found.goodness.residual_tests is None else found.goodness.residual_tests.words,
        "modes": tables.mode_table(rows, band) if len(rows.frequency) else None,
        "resonances": tables.resonance_table(identification.resonances) if identification.resonances else None,
        "stages": tables.stage_table(found),
        "provenance": provenance_table(view.provenance),
        "has_responses": bool(identification.fits),
        "first": identification.fits[0].name if identification.fits and n_records > 1 else "",
        "others": [_other(identification, index) for index in range(1, len(identification.fits))],
        "notes": drawn.notes,
        "beside_model": beside_model,
    }
    return Page("report.html", "report.html.j2", figures, words)


def _record_figures(identification: Identification) -> dict[str, plot.Figure]:
    """Figures by name: responses and residuals of every record of FRFs, and a residual map of the first.

    Names of the second and later records begin with ``record_2_`` and so on.
    """
    figures = {}
    for count, fit in enumerate(identification.fits, 1):
        prefix = f"record_{count}_" if count > 1 else ""
        figures[f"{prefix}frf"] = responses_figure(fit)
        figures[f"{prefix}residual_by_channel"] = residual_channels_figure(fit)
        if count == 1:
            figures["residual_map"] = residual_map_figure(fit)
    return figures


def _modal(identification: Identification, index: int) -> dict[str, object]:
    """Template values for record `index` (from 0) of the records of modes."""
    fit = identification.modal_fits[index]
    is_unknown = any(kind == "mass" for kind in fit.problem.unknowns.kinds)
    return {
        "number": index + 1,
        "title": fit.name,
        "facts": modal_facts(fit, is_unknown),
        "table": modal_table(fit),
        "passed_over": ", ".join(f"{f:.5g}" for f in fit.fitted.passed_over),
    }


def _other(identification: Identification, index: int) -> dict[str, object]:
    """Template values for record `index` (from 0) of the records of responses."""
    part = identification.seen_from(index)
    return {
        "number": index + 1,
        "title": part.fits[0].name,
        "facts": tables.record_facts(part),
        "resonances": tables.resonance_table(part.resonances) if part.resonances else None,
    }


def sorted_warnings(identification: Identification) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Warnings to be shown one by one, and those that repeat one message for many parameters, as two tuples.

    The status and the undetermined directions are shown elsewhere and are in neither. Where there are no more than four
    repetitions, they are in the first tuple and the second is empty.
    """
    estimate = identification.estimate
    elsewhere = {f"the data determine {d.words}" for d in estimate.identifiability.directions}
    elsewhere.add(_status_warning(identification))
    rest = [w for w in identification.warnings if w not in elsewhere]
    repeated = [w for w in rest if _REPEATED.search(w)]
    if len(repeated) <= _MOST_REPEATED:
        return tuple(rest), ()
    return tuple(w for w in rest if w not in repeated), tuple(repeated)


def _status_warning(identification: Identification) -> str:
    estimate = identification.estimate
    return f"{estimate.status_words} ({estimate.message})"


def verdict_words(view: ResultsView) -> dict[str, object]:
    """Template values, by key, for the verdict, its reasons, possible causes, suggested studies and fixed values.

    The table of changes is under ``causes`` if the diagnosis has causes, else under ``lowering``; the other one is
    None, and both are without changes. Fixed values are listed if 1 % of them moves a parameter by 0.1 standard
    deviations. `view` has diagnosis, headline and advice.
    """
    diagnosis = view.diagnosis
    causes = diagnosis.named
    table = Table(_CAUSE_COLUMNS, tuple(_cause_row(cause, causes[0]) for cause in causes), (1, 2)) if causes else None
    telling = [one for one in diagnosis.sensitivities if abs(one.distance[one.most_moved]) >= _TELLING]
    return {
        "verdict": {
            "words": view.headline,
            "mark": _MARKS[view.verdict],
            "next_step": view.next_step,
            "advice": view.advice[:MOST_ADVICE],
            "more": view.advice[MOST_ADVICE:],
        },
        "reasons": diagnosis.judgement.reasons,
        "causes": table if diagnosis.causes else None,
        "lowering": None if diagnosis.causes else table,
        "studies": [(cause.line, cause.study, "\n".join(cause.lines)) for cause in causes if cause.study],
        "tried": f"{plural(diagnosis.n_tried, 'change')} of model and record tried" if diagnosis.n_tried else "",
        "held": fixed_value_table(telling) if telling else None,
        "held_left": plural(len(diagnosis.sensitivities) - len(telling), "fixed value")
        if len(telling) < len(diagnosis.sensitivities)
        else "",
    }


def fixed_value_table(sensitivities: Sequence[FixedValueSensitivity]) -> Table:
    """Sensitivity of the values to what the model fixes, that which moves a value farthest first."""
    return Table(_FIXED_VALUE_COLUMNS, tuple(_fixed_value_row(one) for one in resting(sensitivities)), (2, 3, 4))


def _fixed_value_row(sensitivity: FixedValueSensitivity) -> tuple[str, ...]:
    """Table row of a fixed value: name, parameter moved most, its change (%) per 1 % and in deviations, and the pull.

    The pull is the change, in %, that the record prefers, with its standard deviation.
    """
    largest = sensitivity.most_moved
    pull = (
        f"{percent(sensitivity.pull, 2)} ± {percent(sensitivity.pull_std, 2, signed=False)}"
        if sensitivity.pull_std > 0
        else NOTHING
    )
    return (
        sensitivity.name,
        sensitivity.parameters[largest],
        percent(0.01 * sensitivity.influence[largest], 2),
        number(abs(sensitivity.distance[largest]), 2),
        pull,
    )


def _cause_row(cause: Cause, first: Cause) -> tuple[str, ...]:
    """Table row of one possible cause: text, share of misfit explained, chi-square, added parameters, largest shift.

    Chi-square is per degree of freedom. The shift is that of the parameter that moves most in its standard deviations,
    as "name: before to after" with unit, "" if none is known. `first` is the likeliest cause; the text says if the data
    cannot distinguish `cause` from it.
    """
    alike = " (the data cannot distinguish it from the first)" if cause.is_alike and cause is not first else ""
    added = ", ".join(f"{name} = {with_unit(number(value), unit)}" for name, value, unit in cause.found)
    moved = ""
    if cause.moved:
        one = cause.moved[0]
        moved = f"{one.name}: {number(one.before)} to {with_unit(number(one.after), one.unit)}"
    return cause.line + alike, cause.share_text, number(cause.chi_square_per_dof, 3), added, moved


def free_page(result: StudyResult) -> Page:
    """Report page of an identification with too many parameters for a covariance matrix, with its figures.

    The 25 parameters of largest change are listed. Nothing is written.
    """
    identification = result.identification
    estimate = identification.estimate
    maps = field_figures(identification)
    responses = {f"record_{k}_frf" if k > 1 else "frf": fit for k, fit in enumerate(identification.fits, 1)}
    side_by_side, beside_model = side_by_side_chapter(identification)
    rows = tuple(_changed_row(result, i) for i in largest_changes(estimate, _MOST_CHANGES))
    words = {
        "title": result.study.title,
        "status": estimate.status.value,
        "status_words": f"{estimate.status_words} ({estimate.message})",
        "is_good": estimate.status is Status.CONVERGED and estimate.covariance_basis == "noise",
        "warnings": sorted_warnings(identification)[0],
        "summary": _free_cards(result),
        "maps": [(f"map_{k}", name) for k, name in enumerate(maps, 1)],
        "changes": Table(_CHANGE_COLUMNS, rows, (1, 2, 3, 4)),
        "std_words": _std_words(result),
        "records": [(name, fit.name if len(responses) > 1 else "") for name, fit in responses.items()],
        "modes": mode_table(mode_rows(identification.fits[0]), band_used(identification.fits)),
        "provenance": provenance_table(asdict(result.provenance)),
        "beside_model": beside_model,
    }
    figures = {
        **{f"map_{k}": figure for k, figure in enumerate(maps.values(), 1)},
        **{name: responses_figure(fit) for name, fit in responses.items()},
        **side_by_side,
    }
    return Page("report.html", "free.html.j2", figures, words)


def _free_cards(result: StudyResult) -> tuple[tuple[str, str, str], ...]:
    """Key figures of an identification with very many parameters, as (label, value, remark) for each."""
    identification = result.identification
    estimate = identification.estimate
    error, before = (
        percent(float(np.median(np.concatenate([part.ravel() for part in parts]))), 3, signed=False)
        for parts in (
            [f.relative_error for f in identification.fits],
            [f.initial_relative_error for f in identification.fits],
        )
    )
    has_mass = np.isfinite(identification.mass.total) and identification.mass.total > 0
    mass = f"{with_std(identification.mass.total, identification.mass.std)} kg" if has_mass else NOTHING
    beyond, limit = estimate.beyond_chance()
    lower, higher = (int((beyond & (sense * estimate.distance > 0)).sum()) for sense in (-1, 1))
    basis = "from the residual" if estimate.covariance_basis == "model_error" else "from the noise"
    return (
        (
            "Parameters",
            f"{len(estimate.names)}",
            f"{int(estimate.identified.sum())} of them identified, priors included",
        ),
        (
            "Combinations that the data determine",
            number(estimate.spread.determined, 3),
            "what is left is held by priors",
        ),
        (
            "Changed beyond chance",
            f"{lower} lower, {higher} higher",
            f"more than {number(limit, 3)} standard deviations: 5 % risk of any by chance",
        ),
        (
            "Misfit over what is expected",
            number(float(np.sqrt(estimate.goodness.misfit)), 3),
            f"{estimate.goodness.n_data} data",
        ),
        ("Median relative FRF error", error, f"initial model {before}"),
        ("Total mass", mass, f"standard deviations {basis}"),
        ("Search", plural(estimate.search.n_iterations, "iteration"), search_reason(estimate)),
    )


def _changed_row(result: StudyResult, i: int) -> tuple[str, ...]:
    """Table row of parameter `i` (from 0): name, initial value, identified value, relative change, change in std."""
    estimate = result.identification.estimate
    initial, value, std = float(estimate.initial[i]), float(estimate.values[i]), float(estimate.std[i])
    return (
        estimate.names[i],
        with_unit(number(initial), estimate.units[i]),
        with_unit(with_std(value, std), estimate.units[i]),
        percent(value / initial - 1) if initial else NOTHING,
        number(float(estimate.distance[i]), 3),
    )


def _std_words(result: StudyResult) -> str:
    """Sentence on the number of posterior draws behind the standard deviations, and how accurately these are known.

    It says that they are not known if no standard deviation has an accuracy.
    """
    estimate = result.identification.estimate
    spread = estimate.uncertainty.std_error[np.isfinite(estimate.uncertainty.std_error)]
    if not spread.size:
        return "Standard deviations are not known."
    known = percent(float(spread.max()), 2, signed=False)
    return f"Standard deviations come from {len(estimate.uncertainty.draws)} draws, each known to {known}."


def field_figures(identification: Identification) -> dict[str, plot.Figure]:
    """Figures of element properties over a mesh, by "<property> of <element set>": change and standard deviation.

    Both are relative to the initial value. Only properties that three parameters or more change have a figure.
    """
    estimate, unknown, own = identification.estimate, identification.parameters, identification.own_index
    records = [fit.problem.record for fit in identification.fits]
    before, after = unknown.values(estimate.initial[own]), unknown.values(estimate.values[own])
    design = unknown.design.tocsr()
    sensors = tuple(dict.fromkeys(dof for record in records for dof in record.outputs))
    loads = tuple(dict.fromkeys(dof for record in records for dof in record.inputs))
    drawn = structure_picture(identification.structure, sensors, loads, is_field=True)
    figures = {}
    for item in identification.structure.properties:
        part = design[item.values.start : item.values.stop]
        if len(np.unique(part.indices)) < 3:
            continue
        size = np.where(np.diff(part.indptr) > 0, before[item.values], np.nan)
        wide = sparse.csr_array((part.data, own[part.indices], part.indptr), (part.shape[0], len(estimate.names)))
        std = np.sqrt(estimate.uncertainty.variance(wide))
        change = after[item.values] / size - 1
        name = f"{item.term.property.replace('_', ' ')} of {item.element}"
        figures[name] = _field_figure(
            drawn, (name, item.element), change, std / np.abs(size), estimate.beyond_chance()[1]
        )
    return figures


def _field_figure(
    picture: Picture, names: tuple[str, str], change: FloatArray, std: FloatArray, limit: float
) -> plot.Figure:
    """Figure of relative change beside its standard deviation, by element, with significant areas outlined.

    `names` are the title and the element set; `change` and `std` (n_elements,) are relative to the initial value, NaN without a
    parameter. A change is significant if it exceeds `limit` standard deviations.
    """
    name, elements = names
    texts = [f"{percent(c)} ± {percent(s, 2, signed=False)}" for c, s in zip(change, std, strict=True)]
    sides = [
        {(elements, k): Change(float(values[k]), True, texts[k]) for k in np.flatnonzero(np.isfinite(values)).tolist()}
        for values in (change, std)
    ]
    beyond = np.abs(np.nan_to_num(change)) > limit * np.where(np.isfinite(std), std, np.inf)
    sizes = np.abs([c.ratio for c in sides[0].values()])
    changed = shading(
        f"{name}: relative change", sides[0], round_limit(np.quantile(sizes, [0.999]) if sizes.size else (), 0.02)
    )
    changed = replace(changed, outlined=frozenset((elements, k) for k in np.flatnonzero(beyond).tolist()))
    finite = std[np.isfinite(std)]
    top = (float(np.quantile(finite, 0.99)) if finite.size else 0.0) or 1.0
    ticks = tuple((part * top, percent(part * top, 2, signed=False)) for part in (0.0, 0.25, 0.5, 0.75, 1.0))
    label = "standard deviation of the change"
    scale = plot.ColourScale(palette.SEQUENTIAL, 0.0, top, label, ticks, is_exceeded=bool((finite > top).any()))
    return structure_figure(
        picture, (changed, Shading(f"{name}: {label}", sides[1], scale)), caption=_field_caption(elements, change, std)
    )


def _field_caption(elements: str, change: FloatArray, std: FloatArray) -> str:
    """Caption with the element of the lowest change and the meaning of the colours; "" if no change is known.

    `change` and `std` (n_elements,) are relative; `elements` is the name of the element set.
    """
    if not np.isfinite(change).any():
        return ""
    lowest = int(np.nanargmin(change))
    doubt = f" with a standard deviation of {percent(std[lowest], 2, signed=False)}" if np.isfinite(std[lowest]) else ""
    grey = "" if np.isfinite(change).all() else " Grey: no parameter of this map."
    return (
        f"Lowest at element {lowest + 1} of {elements}: {percent(change[lowest])}{doubt}. A change is to be believed where it"
        f" is several times its standard deviation.{grey}"
    )
