"""A correlation in words and tables, as the terminal shows it, and what pages show of each record beside a model or two."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from structid.compare.response_correlation import ResponsesCorrelation, correlated_responses
from structid.core.arrays import FloatArray
from structid.core.display import NOTHING, first_warnings, likeness, number, percent, plural
from structid.core.errors import InputError, SingularModelError
from structid.identification.identified import Identification
from structid.report.drawing import palette
from structid.report.figures.side_by_side import side_by_side_figure
from structid.report.page import Page, Table, printed, provenance_table
from structid.report.rendering import plot

if TYPE_CHECKING:
    from structid.compare.correlation import StudyCorrelation
    from structid.compare.mode_correlation import ModesCorrelation
    from structid.identification.modal_fit import ModalFit

CORRELATION_PAGE = "correlation.html"
#: Modes of a basis that are named at most.
_MOST_NAMED = 8
#: What the models of a figure are called, one, or two with their colours.
ALONE, BEFORE_AND_AFTER = ("model",), ("initial", "identified")
_COLOURS = {"model": palette.FITTED, "initial": palette.INITIAL, "identified": palette.FITTED}
#: Effect of noise on a MAC that is told: what its three decimals show.
_TOLD = 5e-4
#: FDAC maps at most, of the first loads.
_MOST_MAPS = 2
Figures = dict[str, plot.Figure]


def modes_table(correlation: ModesCorrelation) -> Table:
    """Table with a row for each measured mode: its paired model mode, frequency difference, MAC and remark.

    Modes are numbered from 1. Where the record states errors of shapes, a MAC has its standard deviation, and the
    amount by which noise lowers it in the mean if that is at least 0.0005. Rows of unpaired modes are marked "lost".
    """
    rows, f, mac = [], correlation.model.frequency, correlation.mac_of_pairs
    for i, own in enumerate(correlation.measured.frequency.tolist()):
        k = int(correlation.pairing.number[i])
        pair = (NOTHING,) * 4
        if k >= 0:
            difference = percent(float(correlation.frequency_difference[i]))
            pair = (str(k + 1), number(float(f[k]), 5), difference, likeness(float(correlation.pairing.mac[i, k])))
            if np.isfinite(mac.std[i]):
                by_noise = f", {mac.noise_effect[i]:.1g} by noise" if mac.noise_effect[i] <= -_TOLD else ""
                pair = (*pair[:3], f"{pair[3]} \u00b1 {mac.std[i]:.1g}{by_noise}")
        rows.append((str(i + 1), number(own, 5), *pair, correlation.remark(i)))
    header = ("Measured mode", "Measured (Hz)", "Mode of the model", "Model (Hz)", "Difference", "MAC", "Remark")
    marks = tuple("lost" if k < 0 else "" for k in correlation.pairing.number)
    return Table(header, tuple(rows), tuple(range(6)), marks)


def surplus_table(correlation: ModesCorrelation) -> Table | None:
    """Table of model modes in the measured range that no measured mode is paired with; None if there are none.

    Columns are number of the mode (from 1), frequency (Hz), and the measured mode of largest MAC with that MAC.
    """
    if not correlation.pairing.surplus:
        return None
    rows = []
    for k in correlation.pairing.surplus:
        best = int(np.nan_to_num(correlation.pairing.mac[:, k]).argmax())
        like = f"{best + 1}, MAC {correlation.pairing.mac[best, k]:.2f}"
        rows.append((str(k + 1), number(float(correlation.model.frequency[k]), 5), like))
    return Table(("Mode of the model", "Model (Hz)", "Nearest measured mode"), tuple(rows), (0, 1))


def orthogonality_facts(correlation: ModesCorrelation) -> tuple[tuple[str, str], ...]:
    """Pairs of a label and a text on self- and cross-orthogonality of shapes with the reduced mass; () if not computed.

    Only shapes known at every sensor count. Named are the largest off-diagonal entry and the least entry of a pair.
    """
    own, cross = correlation.self_orthogonality, correlation.cross_orthogonality
    if own is None or cross is None:
        return ()
    name = {"guyan": "static (Guyan)", "serep": "by modes (SEREP)"}[correlation.options.reduction]
    whole = np.flatnonzero(correlation.measured.known.all(axis=0))
    off, paired = np.nan_to_num(own - np.eye(len(own))), np.intersect1d(correlation.pairing.paired, whole)
    pairs = [cross[i, correlation.pairing.number[i]] for i in paired]
    left = f"; of the {plural(len(whole), 'shape')} known at every sensor" if len(whole) < len(own) else ""
    facts = [("Reduction of the mass", name + left)]
    if len(whole) > 1:
        i, j = sorted(int(k) for k in np.unravel_index(np.argmax(off), off.shape))
        facts.append(("Self-orthogonality", f"largest off-diagonal {off.max():.3f}, modes {i + 1} and {j + 1}"))
    if pairs:
        worst = int(paired[int(np.argmin(pairs))])
        facts.append(("Cross-orthogonality", f"least of a pair {min(pairs):.3f}, measured mode {worst + 1}"))
    return tuple(facts)


def expansion_table(correlation: ModesCorrelation) -> Table | None:
    """Table of how well each measured shape was expanded to the model, a row for each; None if none was expanded.

    Columns are mode number, frequency, modes that it is made of, residual at the sensors and median standard deviation.
    """
    if correlation.expanded is None:
        return None
    rows = []
    for i, (residual, median) in enumerate(correlation.expansion_sizes):
        basis = correlation.expanded.basis[i]
        made = ", ".join(str(k + 1) for k in basis) if len(basis) <= _MOST_NAMED else f"{len(basis)} modes near it"
        made = made or ("dynamic stiffness" if correlation.measured.known[:, i].any() else "no shape known")
        sizes = percent(residual, 2, signed=False), percent(median, 2, signed=False)
        rows.append((str(i + 1), number(float(correlation.measured.frequency[i]), 5), made, *sizes))
    header = (
        "Measured mode", "Measured (Hz)", "Made of modes", "Residual at the sensors",
        "Median std of the expanded shape",
    )  # fmt: skip
    return Table(header, tuple(rows), (0, 1, 3, 4))


def resonances_table(correlation: ResponsesCorrelation) -> Table | None:
    """Table of resonances of a record with the closest ones of the model; None if the record shows none.

    Columns are both frequencies (Hz) and the relative difference of the model's (%).
    """
    if not correlation.resonances:
        return None
    rows = tuple(
        (number(one.measured, 5), number(one.predicted, 5), percent(one.predicted / one.measured - 1))
        for one in correlation.resonances
    )
    return Table(("Measured (Hz)", "Model (Hz)", "Difference"), rows, (0, 1, 2))


def frac_table(correlation: ResponsesCorrelation) -> Table:
    """Table of the FRAC of every FRF, with a row for each pair of output and input."""
    rows = tuple(
        (str(output), str(load), f"{correlation.frac[o, i]:.3f}")
        for i, load in enumerate(correlation.record.inputs)
        for o, output in enumerate(correlation.record.outputs)
    )
    return Table(("Output", "Input", "FRAC"), rows, (2,))


def channels_table(correlation: StudyCorrelation) -> Table:
    """Table of the degrees of freedom of the model that each sensor reads or each load acts on."""
    rows = tuple((one.channel, one.role, one.seen) for one in correlation.channels)
    return Table(("Channel", "Role", "Sees"), rows)


def summary_words(correlation: ModesCorrelation) -> str:
    """Sentence, without a full stop, on measured and model modes: pairs, largest frequency difference and least MAC.

    Where no mode is paired, it says only that.
    """
    if not correlation.n_paired:
        return f"None of {plural(correlation.measured.n_modes, 'measured mode')} matches a mode of the model"
    paired = correlation.pairing.paired
    worst = float(np.nanmax(np.abs(correlation.frequency_difference)))
    like = correlation.pairing.mac[paired, correlation.pairing.number[paired]]
    least = f", MAC {np.nanmin(like):.3f} or more" if np.isfinite(like).any() else ""
    return (
        f"{correlation.n_paired} of {plural(correlation.measured.n_modes, 'measured mode')} paired: frequencies within"
        f" {percent(worst, signed=False)}{least}{correlation.measured.unknown_words}"
    )


def frac_words(correlation: ResponsesCorrelation) -> str:
    """Sentence, without a full stop, on measured and model responses: range in Hz, median and least FRAC.

    Where no FRAC is finite, it says that the model does not respond where the record does.
    """
    values = correlation.frac[np.isfinite(correlation.frac)]
    if not values.size:
        return "No function of the model responds where the record does"
    f = correlation.record.frequency
    return (
        f"FRAC from {f[0]:.5g} to {f[-1]:.5g} Hz: median {np.median(values):.3f} of {plural(values.size, 'function')},"
        f" least {values.min():.3f}"
    )


def at_words(correlation: StudyCorrelation) -> str:
    """Words on the values at which the model was evaluated."""
    return (
        "Model at the start values of the study"
        if correlation.at is None
        else f"Model as identified in {correlation.at.name}"
    )


def correlation_text(correlation: StudyCorrelation) -> list[RenderableType]:
    """Correlation of model and test as lines and tables for the terminal."""
    parts: list[RenderableType] = [Text(correlation.study.title, style="bold"), Text(at_words(correlation))]
    parts += [Text(words, style="yellow") for words in first_warnings(correlation.warnings)]
    for part in correlation.modes:
        parts += [Text(_name_prefix(part.name, summary_words(part)), style="bold"), printed(modes_table(part))]
        parts += [Text(f"{label}: {words}") for label, words in orthogonality_facts(part)]
    for response in correlation.responses:
        parts += [Text(_name_prefix(response.name, frac_words(response)), style="bold"), printed(frac_table(response))]
        table = resonances_table(response)
        parts += [] if table is None else [Text("Resonances"), printed(table)]
    return parts


def _name_prefix(name: str, words: str) -> str:
    return f"{name}: {words}" if name else words


def modes_part(correlations: Sequence[ModesCorrelation], key: str) -> tuple[Figures, dict[str, object]]:
    """Figures by name, and template values by key, on the measured modes of a record against one or two models.

    `correlations` are the correlations with each model (initial before identified); tables are those of the last. Names
    of figures begin with `key`. Figures that cannot be made are left out.
    """
    last, model_names = correlations[-1], ALONE if len(correlations) == 1 else BEFORE_AND_AFTER
    figures = {
        f"{key}_mac": mac_figure(correlations, model_names),
        f"{key}_comac": comac_figure(correlations, model_names) if last.n_paired else None,
        f"{key}_shapes": side_by_side_figure(last),
    }
    template_values = {
        "key": key,
        "is_modal": True,
        "title": last.name,
        "words": [
            _count_phrase(model_name, summary_words(correlation), len(correlations))
            for model_name, correlation in zip(model_names, correlations, strict=True)
        ],
        "warnings": last.warnings,
        "table": modes_table(last),
        "surplus": surplus_table(last),
        "facts": orthogonality_facts(last),
        "expansion": expansion_table(last),
        "resonances": None,
    }
    return {name: figure for name, figure in figures.items() if figure is not None}, template_values


def responses_part(correlations: Sequence[ResponsesCorrelation], key: str) -> tuple[Figures, dict[str, object]]:
    """Figures by name, and template values by key, on measured responses against one or two models.

    `correlations` are the correlations with each model (initial before identified); the table of resonances is that of
    the last. Names of figures begin with `key`. Figures that cannot be made are left out.
    """
    last, model_names = correlations[-1], ALONE if len(correlations) == 1 else BEFORE_AND_AFTER
    figures = {
        f"{key}_frac": frac_figure(correlations, model_names),
        f"{key}_fdac": fdac_figure(correlations, model_names),
    }
    template_values = {
        "key": key,
        "is_modal": False,
        "title": last.name,
        "words": [
            _count_phrase(model_name, frac_words(correlation), len(correlations))
            for model_name, correlation in zip(model_names, correlations, strict=True)
        ],
        "warnings": last.warnings,
        "resonances": resonances_table(last),
    }
    return {name: figure for name, figure in figures.items() if figure is not None}, template_values


def _count_phrase(model_name: str, sentence: str, n_models: int) -> str:
    inside = sentence if sentence[:2].isupper() else sentence[0].lower() + sentence[1:]
    return f"{sentence}." if n_models == 1 else f"{model_name.capitalize()} model: {inside}."


def before_and_after(
    identification: Identification,
) -> tuple[
    tuple[tuple[ModesCorrelation, ModesCorrelation], ...], tuple[tuple[ResponsesCorrelation, ResponsesCorrelation], ...]
]:
    """Comparisons of each record with the initial and with the identified model: of modes, then of responses.

    Both parts hold one pair (initial, identified) for each record of their kind. A record whose model cannot be evaluated, as
    after a search that failed, is left out.
    """
    modal, responses = [], []
    for modal_fit in identification.modal_fits:
        with suppress(InputError, SingularModelError):
            values = modal_fit.initial_values, modal_fit.problem.physical(modal_fit.theta)
            before, after = (_fitted_modes(modal_fit, physical) for physical in values)
            modal.append((before, after))
    for fit in identification.fits:
        with suppress(InputError):
            record, both = fit.evaluation, (fit.evaluation_initial, fit.evaluation_predicted)
            first, last = (correlated_responses(record, model, fit.name) for model in both)
            responses.append((first, last))
    return tuple(modal), tuple(responses)


def _fitted_modes(fit: ModalFit, physical: FloatArray) -> ModesCorrelation:
    """Correlation of the measured modes of a fit with those of its model at the parameter values `physical` (n_params,)."""
    from structid.compare.mode_correlation import correlated_modes  # for records of modes alone
    from structid.compare.options import DEFAULT

    problem = fit.problem
    values = problem.property_values(physical)
    return correlated_modes(problem.structure, values, fit.measured, DEFAULT, problem.settings, fit.name)


def side_by_side_chapter(identification: Identification) -> tuple[Figures, list[dict[str, object]]]:
    """Figures by name, and template values of each record, that compare it with the initial and the identified model.

    Records of modes come first. A single record has no title.
    """
    modal, responses = before_and_after(identification)
    figures, parts = _chapter(modal, responses, "correlation_{}_modes", "correlation_{}_responses")
    if len(parts) == 1:
        parts[0]["title"] = ""
    return figures, parts


def _chapter(
    modal: Sequence[Sequence[ModesCorrelation]],
    responses: Sequence[Sequence[ResponsesCorrelation]],
    modes_key: str,
    responses_key: str,
) -> tuple[Figures, list[dict[str, object]]]:
    """Figures by name, and template values of each record, that compare measured and model modes and responses.

    Each entry of `modal` and `responses` holds the correlations of a record with one or two models. The keys, such as
    "modes_{}", become the beginnings of the names of figures, with the number of the record from 1.
    """
    made = [modes_part(both, modes_key.format(k)) for k, both in enumerate(modal, 1)]
    made += [responses_part(both, responses_key.format(k)) for k, both in enumerate(responses, 1)]
    return {name: figure for drawn, _ in made for name, figure in drawn.items()}, [told for _, told in made]


def correlation_page(correlation: StudyCorrelation) -> Page:
    """Report page of a correlation of model and test, with its figures."""
    modal, responses = [[one] for one in correlation.modes], [[one] for one in correlation.responses]
    figures, parts = _chapter(modal, responses, "modes_{}", "responses_{}")
    words = {
        "title": correlation.study.title,
        "at": at_words(correlation),
        "is_paired": correlation.is_paired,
        "warnings": correlation.warnings,
        "parts": parts,
        "channels": channels_table(correlation),
        "provenance": provenance_table(asdict(correlation.provenance)),
    }
    return Page(CORRELATION_PAGE, "correlation.html.j2", figures, words)


def mac_figure(correlations: Sequence[ModesCorrelation], model_names: Sequence[str]) -> plot.Figure:
    """Matrix figure of the MAC between measured modes (rows) and model modes, a panel for each model, pairs framed.

    Columns are the model modes in or near the measured range, all if there are none. `correlations` holds one
    correlation for each model, `model_names` the models' names, `ALONE` or `BEFORE_AND_AFTER`.
    """
    scale = plot.ColourScale(palette.SEQUENTIAL, 0.0, 1.0, "MAC")
    panels, largest = [], 1
    for correlation, model_name in zip(correlations, model_names, strict=True):
        shown = correlation.shown if len(correlation.shown) else np.arange(correlation.model.frequency.size)
        rows = [f"{i + 1}: {f:.4g} Hz" for i, f in enumerate(correlation.measured.frequency)]
        columns = [f"{k + 1}: {correlation.model.frequency[k]:.4g}" for k in shown]
        made = plot.matrix_panel(
            correlation.pairing.mac[:, shown],
            rows,
            "measured mode",
            scale,
            columns,
            f"mode of the {_model(model_name)}, Hz",
        )
        column = {int(k): j for j, k in enumerate(shown)}
        cells = [
            (column[k], i)
            for i in correlation.pairing.paired.tolist()
            for k in correlation.pairing.partners(i)
            if k in column
        ]
        frames = _frames(np.array(cells, dtype=float).reshape(-1, 2))
        (strip,) = made.strips
        strips = (replace(strip, traces=(*strip.traces, *frames)),)
        is_large = max(len(rows), len(columns)) > plot.MOST_WRITTEN
        panels.append(replace(made, strips=strips, title=_title(model_name, len(correlations)), equal=not is_large))
        largest = max(largest, len(rows), len(columns))
    size = float(np.clip(280 + 26 * largest, 400, 760))
    caption = (
        "Modal assurance criterion of measured and modelled shapes at the sensors: 1 where they agree up to a factor. Framed:"
        " the pairs, chosen by MAC and frequency together."
    )
    return plot.Figure(tuple(panels), (size + 60, size), len(panels) if size < 560 else 1, caption)


def _frames(cells: FloatArray) -> list[plot.Curve]:
    """Curve of square frames around the matrix cells `cells` (n, 2), given as column and row; [] if there are none."""
    if not len(cells):
        return []
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1), (np.nan, np.nan)]) * 0.47
    path = (cells[:, None] + corners).reshape(-1, 2)
    return [plot.Curve(path[:, 0], path[:, 1], plot.Pen(palette.VERMILLION, 2.2), label="pair")]


def comac_figure(correlations: Sequence[ModesCorrelation], model_names: Sequence[str]) -> plot.Figure:
    """Bar charts of COMAC and ECOMAC of every sensor, over all mode pairs, in two panels, with one bar for each model.

    `correlations` holds one correlation for each model, `model_names` the models' names.
    """
    names = [str(dof) for dof in correlations[-1].measured.channels]
    panels = (
        _bars(
            names,
            "sensor",
            plot.Axis("COMAC", "1", (0.0, 1.05)),
            [correlation.comac for correlation in correlations],
            model_names,
        ),
        _bars(
            names, "sensor", plot.Axis("ECOMAC", "1"), [correlation.ecomac for correlation in correlations], model_names
        ),
    )
    caption = (
        "By sensor, over all pairs. COMAC: 1 where the sensor follows the model in every mode; a sensor that is only turned"
        " round keeps its COMAC. ECOMAC: mean distance of the scaled shapes, 0 where they agree. Check sense, gain and position"
        " of a sensor that stands out."
    )
    return plot.Figure(panels, (1050.0, 300.0), 1, caption)


def frac_figure(correlations: Sequence[ResponsesCorrelation], model_names: Sequence[str]) -> plot.Figure:
    """Bar charts of the FRAC of every output, one panel for each load, with one bar for each model.

    `correlations` holds one correlation for each model, `model_names` the models' names.
    """
    record = correlations[-1].record
    names = [str(dof) for dof in record.outputs]
    panels = tuple(
        _bars(
            names,
            "output",
            plot.Axis("FRAC", "1", (0.0, 1.05)),
            [correlation.frac[:, i] for correlation in correlations],
            model_names,
            f"load {load}" if len(record.inputs) > 1 else "",
        )
        for i, load in enumerate(record.inputs)
    )
    caption = (
        "Frequency response assurance criterion along the lines judged: 1 where measured and modelled function agree up to a"
        " factor; a resonance off by its own width already costs most of it."
    )
    return plot.Figure(panels, (1050.0, 300.0), 1, caption)


def fdac_figure(correlations: Sequence[ResponsesCorrelation], model_names: Sequence[str]) -> plot.Figure | None:
    """Matrix figure of the FDAC, measured lines (rows) against model lines, a panel for each load and model.

    None if it was not computed, as for a single output. Only the first two loads are drawn. `correlations` holds one
    correlation for each model, `model_names` the models' names.
    """
    if any(correlation.fdac is None for correlation in correlations):
        return None
    scale = plot.ColourScale(palette.SEQUENTIAL, 0.0, 1.0, "FDAC")
    panels = []
    for i, load in enumerate(correlations[-1].record.inputs[:_MOST_MAPS]):
        for correlation, model_name in zip(correlations, model_names, strict=True):
            f = correlation.record.frequency[correlation.map_lines]
            edges = np.concatenate([[f[0]], 0.5 * (f[1:] + f[:-1]), [f[-1]]])
            values = np.round(correlation.fdac[i], 3) if correlation.fdac is not None else np.zeros((len(f), len(f)))
            cells = plot.HeatMap(edges, edges, values, tuple(f"measured {line:.5g} Hz" for line in f))
            ends = (float(f[0]), float(f[-1]))
            x = plot.Axis(f"frequency of the {_model(model_name)}", "Hz", ends, grid=False)
            y = plot.Axis("measured frequency", "Hz", ends, grid=False)
            diagonal = plot.segments(([ends[0]], [ends[1]]), ([ends[0]], [ends[1]]), plot.Pen("white", 1.2, "dash"))
            title = _title(model_name, len(correlations)) + (
                f", load {load}" if len(correlation.record.inputs) > 1 else ""
            )
            panels.append(replace(plot.panel(x, y, cells, diagonal, scale=scale), equal=True, title=title.lstrip(", ")))
    caption = (
        "Frequency domain assurance criterion: agreement of the operating shapes at every pair of lines. A ridge of ones below"
        " the dashed diagonal: the model has the same shapes at higher frequencies, it is too stiff or too light; above it,"
        " too soft or too heavy."
    )
    return plot.Figure(tuple(panels), (520.0, 460.0), 2, caption)


def _bars(
    names: Sequence[str],
    label: str,
    y: plot.Axis,
    values: Sequence[FloatArray],
    model_names: Sequence[str],
    title: str = "",
) -> plot.Panel:
    """Bar chart panel with a group of bars for each of `names`, one bar for each model.

    `values` holds one array (n_names,) for each model, `model_names` the models' names; `label` is that of the
    horizontal axis. NaN has no bar. `title` stands above the panel. `y` is the axis of values; without limits it begins
    at 0.
    """
    positions, count = np.arange(len(names), dtype=float), len(values)
    width = 0.8 / count
    traces: list[plot.Trace] = []
    for k, (heights, model_name) in enumerate(zip(values, model_names, strict=True)):
        finite = np.isfinite(heights)
        left = positions[finite] - 0.4 + k * width
        legend = model_name if count > 1 else ""
        traces.append(plot.boxes((left, left + width), (0.0, heights[finite]), _COLOURS[model_name], legend))
        texts = tuple(
            f"{name}: {value:.3f}" for name, value in zip(names, heights.tolist(), strict=True) if value == value
        )
        traces.append(plot.Curve(left + width / 2, heights[finite], None, plot.UNSEEN, hover=texts))
    highest = max((float(np.nanmax(heights)) for heights in values if np.isfinite(heights).any()), default=1.0)
    x = plot.Axis(label, limits=(-0.6, len(names) - 0.4), ticks=plot.named_ticks(names, 50), grid=False)
    limits = y.limits or (0.0, 1.1 * highest or 1.0)
    return plot.panel(x, replace(y, limits=limits), *traces, title=title)


def _model(model_name: str) -> str:
    return model_name if model_name == "model" else f"{model_name} model"


def _title(model_name: str, count: int) -> str:
    return f"{model_name} model" if count > 1 else ""
