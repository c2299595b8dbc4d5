"""The tables of the report as rows of text."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import (
    DASH,
    NOTHING,
    TIMES,
    exact,
    likeness,
    number,
    percent,
    plural,
    prefixed,
    span_text,
    unit_text,
    with_std,
    with_unit,
)
from structid.fem import Structure
from structid.fem.elements import ElementSet
from structid.identification.alternatives import Alternatives
from structid.identification.identified import Identification
from structid.identification.record_fit import Resonance
from structid.identification.varying import Varied
from structid.inversion import Estimate
from structid.report.figures.parameters import RIGID, ModeRows
from structid.report.page import Table
from structid.study.results.view import ResultsView

if TYPE_CHECKING:
    from structid.identification.modal_fit import ModalFit

_FORMS = {
    "output": "difference of measured and modelled FRF over its standard deviation (maximum likelihood)",
    "log": "difference of the logarithms of measured and modelled FRF (errors in proportion to the FRF)",
    "pole_free": "difference over the mean size of measured and modelled FRF (bounded near resonances)",
    "equation": "equation error of the measured outputs",
}
_MODAL_FORMS = {
    "output": "frequencies and shapes of paired modes over their standard deviations",
    "dynamic": "smallest force that makes a measured shape a motion of the model (unmeasured places eliminated)",
}
_MAC = "frequencies over their standard deviations, and 1 - MAC of each shape over the square of `shape_error`"
_NOISE = {
    "coherence": "from coherence and number of averages",
    "repeats": "from the scatter of repeated measurements",
    "declared": "declared by the user",
    "scatter": "from the scatter of neighbouring lines",
    "unknown": "not stated",
}
_INTERVALS = {
    "laplace": "from the curvature at the estimate (Laplace), taken to physical units: not symmetric for a positive"
    " or bounded parameter",
    "profile": "from the profile likelihood: all other parameters fitted again at each value",
    "bootstrap": "from refits to data drawn again (bootstrap), 400 of them",
    "sampling": "from samples of the posterior by the no-U-turn sampler",
}

#: Sets of values that stand side by side.
_MOST_SETS = 12


def value_table(view: ResultsView) -> Table:
    """Table of every parameter with standard deviation, 95 % interval, initial value and state.

    Rows of parameters that are not determined are marked "doubtful". `view` lists the parameters in the order of the
    rows.
    """
    header = ("Parameter", "Identified ± std", "95\u00a0% interval", "Initial", "State")
    rows = tuple(
        (
            one.name,
            f"{one.value_text} {one.unit_text}".strip(),
            one.interval_with_unit,
            f"{exact(one.scaled(one.initial))} {one.unit_text}".strip(),
            one.state,
        )
        for one in view.listed
    )
    marks = tuple("" if one.is_determined else "doubtful" for one in view.listed)
    return Table(header, rows, (1, 2, 3), marks)


def parameter_table(view: ResultsView) -> Table:
    """Table of every parameter with prior, change, and standard deviations from noise and from model error.

    The standard deviation beside the value is the adopted one, named in the header. `view` lists the parameters in the
    order of the rows.
    """
    estimate = view.identification.estimate
    adopted = "model error" if estimate.covariance_basis == "model_error" else "noise"
    adopted += "" if estimate.fixed is None else " and tolerances"
    header = (
        "Parameter", "Unit", "Prior", f"Identified ± std ({adopted}, adopted)", "Relative std", "Change",
        "Std (noise)", "Std (model error)",
    )  # fmt: skip
    rows = []
    for one in view.listed:
        has_prior, value = math.isfinite(one.prior_std), one.value
        rows.append(
            (
                one.name,
                one.unit_text or "1",
                with_std(one.scaled(one.prior_mean), one.scaled(one.prior_std)) if has_prior else NOTHING,
                one.value_text,
                percent(one.std / abs(value), 2, signed=False, most_decimals=6) if value else NOTHING,
                percent(value / one.initial - 1) if one.initial else NOTHING,
                number(one.scaled(one.std_noise), 2),
                number(one.scaled(one.std_model_error), 2),
            )
        )
    return Table(header, tuple(rows), (2, 3, 4, 5, 6, 7))


def alternatives_table(sets: Alternatives) -> Table:
    """Table of sets of values that fit equally well, one column each, and a row with the measurement that would decide.

    Only the first 12 sets are shown. The row of the measurement, with its value for each set, is left out if none is
    known.
    """
    count = min(len(sets), _MOST_SETS)
    header = ("Parameter", "Unit", *(f"Set {k + 1}" for k in range(count)))
    rows = []
    for name, unit, values in zip(sets.names, sets.units, sets.values[:count].T.tolist(), strict=True):
        factor, shown = prefixed(unit, *values)
        rows.append((name, shown or "1", *(number(value / factor, 5) for value in values)))
    if sets.deciding is not None:
        predicted = (number(value, 3) for value in sets.deciding.predicted[:count])
        rows.append((f"would decide: {sets.deciding.name}", sets.deciding.unit or "1", *predicted))
    return Table(header, tuple(rows), tuple(range(2, count + 2)))


def varied_table(identification: Identification, varied: Varied) -> Table:
    """Table of the value of a varying parameter in each record, with its distance from the common value in scatters.

    `varied` is the parameter; values, standard deviations and 95 % intervals are those of `identification`. Rows of
    outlying values are marked "doubtful".
    """
    found, ends = identification.estimate, identification.intervals.ends
    header = ("Record", "Parameter", "Unit", "Own value ± std", "95\u00a0% interval", "Scatters from the common value",
              "p of chance (Holm)", "")  # fmt: skip
    rows = []
    for record, common, own, deviation, p, outlying in varied.parts:
        i = found.names.index(own)
        value = with_std(float(found.values[i]), float(found.std[i]))
        span = span_text(float(ends[i, 0]), float(ends[i, 1]))
        unit = unit_text(found.units[i]) or "1"
        rows.append(
            (record, common, unit, value, span, number(deviation, 2), number(p, 2), "stands out" if outlying else "")
        )
    return Table(header, tuple(rows), (3, 4, 5, 6), tuple("doubtful" if row[-1] else "" for row in rows))


def interval_words(identification: Identification) -> str:
    """Sentence on how the intervals of the parameters were computed."""
    return _INTERVALS[identification.intervals.kind]


def residual_table(estimate: Estimate) -> Table | None:
    """Table of statistical tests of the residual of every channel; None if there are no tests.

    Rows of channels whose residual is not white, or whose signs do not alternate as those of noise, are marked
    "doubtful".
    """
    tests = estimate.goodness.residual_tests
    if tests is None:
        return None
    header = (
        "Channel", "Lines", "First autocorrelation", "p of whiteness", "Runs", "Runs expected", "p of runs",
    )  # fmt: skip
    rows = [
        (
            test.name, str(test.n_rows), number(test.lag_1, 2), number(test.whiteness_probability, 2), str(test.runs),
            number(test.runs_expected, 3), number(test.runs_probability, 2),
        )
        for test in tests.series
    ]  # fmt: skip
    doubtful = {*tests.not_white, *tests.one_sided}
    marks = tuple("doubtful" if test.name in doubtful else "" for test in tests.series)
    return Table(header, tuple(rows), (1, 2, 3, 4, 5, 6), marks)


def mode_table(rows: ModeRows, band: tuple[float, float]) -> Table:
    """Table of modes of initial and identified model; the last column says "yes" for modes in `band`, else "no".

    `rows` has the frequencies (Hz), damping ratios and MAC of the modes, `band` (low, high) is in Hz. A mode below 1e-4
    of the highest frequency is a rigid body mode. The number of a mode is followed by that in the initial model where
    it is another.
    """
    header = (
        "Mode", "Initial frequency (Hz)", "Identified frequency (Hz)", "Change",
        "Initial damping ratio", "Identified damping ratio", "MAC with initial shape", "In the band used",
    )  # fmt: skip
    table = []
    for i in range(len(rows.frequency)):
        before, after = float(rows.initial_frequency[i]), float(rows.frequency[i])
        rigid = after < RIGID * float(rows.frequency.max())
        table.append(
            (
                str(i + 1) + ("" if rows.initial_number[i] == i + 1 else f" (was {rows.initial_number[i]})"),
                number(before, 5),
                "0 (rigid body)" if rigid else number(after, 5),
                NOTHING if rigid or before <= 0 else percent(after / before - 1),
                percent(float(rows.initial_damping[i]), 3, signed=False),
                NOTHING if rigid else percent(float(rows.damping[i]), 3, signed=False),
                f"{rows.mac[i]:.2f}",
                "yes" if band[0] <= after <= band[1] else "no",
            )
        )
    return Table(header, tuple(table), (0, 1, 2, 3, 4, 5, 6))


def resonance_table(resonances: tuple[Resonance, ...]) -> Table:
    """Table of measured resonances (Hz) beside those of the fitted model, and their relative difference."""
    rows = [
        (number(r.measured, 5), number(r.predicted, 5), percent(r.predicted / r.measured - 1))
        if math.isfinite(r.predicted)
        else (number(r.measured, 5), NOTHING, NOTHING)
        for r in resonances
    ]
    return Table(("Measured resonance (Hz)", "Fitted model (Hz)", "Difference"), tuple(rows), (0, 1, 2))


def direction_table(estimate: Estimate) -> Table:
    """Table of the directions that the data do not determine, as text, with the relative standard deviation along each."""
    directions = estimate.identifiability.directions
    rows = tuple((f"the data determine {d.words}", number(d.relative_std, 2)) for d in directions)
    return Table(("In words", "Relative std along it"), rows, (1,))


def record_facts(identification: Identification) -> tuple[tuple[str, str], ...]:
    """Pairs of a label and a text on the first record of FRFs: source, lines, sensors, loads, noise and residual.

    The last is the form of the residual, such as output or logarithm.
    """
    whole, problem = identification.measured, identification.problem
    used = problem.record
    errors = "none stated" if used.variance is None else _NOISE.get(used.noise_source, used.noise_source)
    if used.variance is not None:
        size = np.maximum(np.abs(used.values), np.finfo(float).tiny)
        median = float(np.median(np.sqrt(used.variance) / size))
        errors += f"; median {percent(median, 2, signed=False)} of the magnitude"
    lines = (
        f"{len(used.frequency)} of {len(whole.frequency)}, {_span(used.frequency)} Hz of {_span(whole.frequency)} Hz"
    )
    averages = f", {used.averages} averages" if used.averages else ""
    coherence = "none" if used.coherence is None else f"in the record{averages}"
    assumed = f"{percent(problem.model_error, 3, signed=False)} of the magnitude" if problem.model_error else "none"
    apart = not np.array_equal(used.frequency, identification.evaluation.frequency)
    judged = (("Lines judged", _judged(identification)),) if apart else ()
    facts = [
        ("Source", whole.source or "not stated"),
        ("Kind and unit", ", ".join(word for word in (whole.kind, unit_text(whole.unit)) if word)),
        ("Lines used", lines + _gaps(whole.frequency, used.frequency)),
        *judged,
        ("Sensors", _list_items(map(str, used.outputs))),
        ("Support that drives" if whole.is_per_motion else "Loads", _list_items(map(str, used.inputs))),
        ("Coherence", coherence),
        ("Noise", errors),
        ("Model error assumed", assumed),
        ("Residual", _FORMS.get(problem.form, problem.form)),
    ]
    return tuple(facts)


def structure_facts(structure: Structure) -> tuple[tuple[str, str], ...]:
    """Pairs of a label and a text on the structure: nodes, degrees of freedom, supports, constraints and damping."""
    positions = np.array(list(structure.nodes.values()))
    extent = f" {TIMES} ".join(exact(float(x), 4) for x in np.ptp(positions, axis=0))
    ties = [f"{tie.name} ({type(tie).__name__})" for tie in structure.ties]
    ratio = structure.damping_ratio
    return (
        ("Nodes", f"{len(structure.nodes)} in {structure.dimension}-D, extent {extent} m"),
        ("Free degrees of freedom", str(structure.n_dofs)),
        ("Directions", " ".join(structure.active or ())),
        ("Fixed", _list_items(d.place for d in structure.fixed)),
        ("Links and constraints", _list_items(ties)),
        *(("Reduced", one.words) for one in structure.reductions),
        *(() if ratio is None else (("Damping ratio of all modes", exact(ratio, 4)),)),
    )


def element_table(structure: Structure) -> Table:
    """Table of element sets with type, number of elements, and ranges of nominal properties.

    Properties that are 0 throughout, and factors of lengths, are left out.
    """
    rows = []
    for element in structure.sets:
        properties = [p for p in structure.properties if p.element == element.name]
        texts = [
            f"{p.term.property.replace('_', ' ')} {with_unit(_range(p.term.values), p.term.unit)}"
            for p in properties
            if np.any(p.term.values) and p.term.kind != "length"
        ]
        rows.append((element.name, _type_words(element), str(len(element.nodes)), "; ".join(texts) or NOTHING))
    return Table(("Element set", "Type", "Elements", "Nominal properties"), tuple(rows), (2,))


def stage_table(estimate: Estimate) -> Table | None:
    """Table of the stages of the search: iterations, first and last sum of squares; None if the search has no stages."""
    rows = tuple(
        (stage.name, str(len(stage.costs) - 1), number(float(stage.costs[0])), number(float(stage.costs[-1])))
        for stage in estimate.search.stages
    )
    header = ("Stage", "Iterations", "First sum of squares", "Last sum of squares")
    return Table(header, rows, (1, 2, 3)) if rows else None


def summary_facts(identification: Identification) -> tuple[tuple[str, str, str], ...]:
    """Key figures of an identification, as (label, value, remark): mass, status, rank, misfit and, for FRFs, their error."""
    estimate = identification.estimate
    mass, std = identification.mass.total, identification.mass.std
    has_mass = np.isfinite(mass) and mass > 0
    rank, n = estimate.identifiability.rank, estimate.identifiability.n_free
    of = f"{n} free ones" if n < len(estimate.names) else str(n)
    basis = "carries model error" if estimate.covariance_basis == "model_error" else "from noise alone"
    fit = estimate.goodness
    chance = f"{fit.degrees_of_freedom} degrees of freedom, probability {number(fit.chi_square_probability, 2)}"
    steps = f"{plural(estimate.search.n_iterations, 'iteration')}; {estimate.message}"
    remark = "; an error of 1 % in the force is one of 1 % here" if identification.mass.scale_from_force else ""
    weighed = (
        (f"{with_std(mass, std)}\u00a0kg", f"standard deviation {basis}{remark}")
        if has_mass
        else (NOTHING, "no mass in kg")
    )
    return (
        ("Total mass", *weighed),
        ("Status", estimate.status.value.replace("_", " "), steps),
        ("Rank", f"{rank} of {of}", f"condition {number(estimate.identifiability.condition, 2)}"),
        ("Misfit over what is expected", number(float(np.sqrt(estimate.goodness.misfit)), 3), chance),
        *(_frf_cards(identification) if identification.fits else ()),
    )


def _frf_cards(identification: Identification) -> tuple[tuple[str, str, str], ...]:
    """Key figure of the FRF errors, as (label, value, remark), of the identified model and of the initial one."""
    error = percent(float(np.median(identification.relative_error)), 3, signed=False)
    before = percent(float(np.median(identification.fits[0].initial_relative_error)), 3, signed=False)
    return (("Median relative FRF error", error, f"initial model {before}; lines {_judged(identification)}"),)


def _judged(identification: Identification) -> str:
    frequency = identification.evaluation.frequency
    return f"{len(frequency)}, {_span(frequency)} Hz"


def _span(frequency: FloatArray) -> str:
    return f"{exact(float(frequency[0]), 4)}{DASH}{exact(float(frequency[-1]), 4)}"


def _gaps(record_frequency: FloatArray, fit_frequency: FloatArray) -> str:
    """Text on frequency ranges inside the band that were left out, beginning with a comma; "" if there are none.

    With more than six ranges it gives the number of lines instead. `record_frequency` and `fit_frequency` (n,) are the
    frequencies of the record and of the fit, Hz, increasing.
    """
    inside = record_frequency[(record_frequency >= fit_frequency[0]) & (record_frequency <= fit_frequency[-1])]
    out = ~np.isin(inside, fit_frequency)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], out.astype(int), [0]])))
    if len(edges) > 12:
        return f", without {int(out.sum())} lines in between"
    parts = [_span(inside[a:b]) for a, b in edges.reshape(-1, 2)]
    return f", without {', '.join(parts)} Hz" if parts else ""


def _list_items(items: Iterable[str]) -> str:
    """The items joined by commas, with their number first if they are more than six; "none" if there are none."""
    words = list(items)
    if not words:
        return "none"
    return (f"{len(words)}: " if len(words) > 6 else "") + ", ".join(words)


def _range(values: FloatArray) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return exact(low) if high - low <= 1e-9 * abs(high) else f"{exact(low, 4)} to {exact(high, 4)}"


def _type_words(element: ElementSet) -> str:
    name = type(element).__name__
    return "".join(f" {c.lower()}" if c.isupper() else c for c in name).strip()


def modal_table(fit: ModalFit) -> Table:
    """Table with a row for each measured mode of a record and its pair in the initial and the fitted model.

    Columns are frequencies (Hz) and their differences (%, and in standard deviations), MAC, number of the model's mode
    (from 1), damping ratios (%), and the size of a group of close modes with its largest angle.
    """
    problem = fit.problem
    header = (
        "Mode", "Measured ± std (Hz)", "Initial model (Hz)", "Difference", "Fitted model (Hz)", "Difference",
        "Difference / std", "Initial MAC", "Fitted MAC", "Mode of the model", "Measured damping ratio",
        "Fitted damping ratio", "Close modes",
    )  # fmt: skip
    groups = {int(mode): group for group in problem.data.groups for mode in group.members}
    rows = []
    for i, mode in enumerate(problem.data.measured.tolist()):
        f, std = float(problem.record.frequency[mode]), float(problem.data.frequency_std[i])
        before, after = float(fit.initial.frequency[i]), float(fit.fitted.frequency[i])
        size = len(groups[mode].members)
        angle = f"{size}, largest angle {number(float(np.degrees(fit.fitted.angle[i])), 2)}°"
        rows.append(
            (
                str(mode + 1), with_std(f, std), number(before, 5), percent(before / f - 1), number(after, 5),
                percent(after / f - 1), number((after - f) / std, 2), likeness(float(fit.initial.mac[i])),
                likeness(float(fit.fitted.mac[i])), str(int(fit.fitted.number[i]) + 1),
                percent(float(problem.record.damping_ratio[mode]), 3, signed=False),
                percent(float(fit.fitted.damping_ratio[i]), 3, signed=False), angle if size > 1 else NOTHING,
            )
        )  # fmt: skip
    return Table(header, tuple(rows), tuple(range(12)))


def modal_facts(fit: ModalFit, masses_unknown: bool) -> tuple[tuple[str, str], ...]:
    """Pairs of a label and a text on a record of measured modes: source, modes, sensors, errors, residual and scale.

    `masses_unknown` is True if masses are among the parameters, so that modes alone give ratios only.
    """
    problem, record = fit.problem, fit.measured
    covariance_words = "with covariance" if record.covariance is not None else "no covariance"
    assumed = [
        f"{percent(value, 3, signed=False)} of each {what}"
        for value, what in (
            (problem.settings.frequency_error, "frequency"),
            (problem.settings.damping_error, "damping ratio"),
        )
        if value
    ]
    assumed += [f"{percent(problem.settings.shape_error, 3, signed=False)} of the largest shape entry"] * bool(
        problem.settings.shape_error
    )
    residual = (
        _MAC
        if problem.settings.shape_form == "mac" and problem.settings.form == "output"
        else _MODAL_FORMS[problem.settings.form]
    )
    f = record.frequency[problem.data.measured]
    scale = (
        "modes give ratios of stiffness to mass only; kilograms depend on "
        + ("known masses, priors or other records" if masses_unknown else "the masses of the model")
    )  # fmt: skip
    return (
        ("Source", record.source or "not stated"),
        ("Modes used", f"{plural(len(f), 'mode')}, {number(float(f[0]))} to {number(float(f[-1]))} Hz"),
        ("Sensors", ", ".join(map(str, record.channels)) + record.unknown_words),
        ("Uncertainty", covariance_words),
        ("Error assumed besides", ", ".join(assumed) or "none"),
        ("Residual", residual + (", with damping ratios" if problem.settings.use_damping else "")),
        ("What pulls", _pull(fit)),
        ("Absolute size", scale),
    )


def _pull(fit: ModalFit) -> str:
    """Text on the parameters that each kind of measured value (frequencies, shapes, ...) determines, and its misfit.

    Given are the number of parameters and the part of the misfit. Priors are named last where they determine more than
    0.5 % of the parameters. It says so instead if these modes alone do not determine every parameter.
    """
    from structid.forward.modal.problem import influence_by_kind  # for records of modes alone

    influence = influence_by_kind(fit.problem, fit.theta)
    if not influence:
        return "not told: these modes alone do not determine every parameter"
    n_params = fit.problem.unknowns.n_params
    parts = [
        f"{kind} ({plural(rows, 'value')}) determine {number(own, 2)} of {plural(n_params, 'parameter')} and make"
        f" {percent(misfit, 2, signed=False)} of the misfit"
        for kind, (rows, own, misfit) in influence.items()
    ]
    rest = n_params - sum(own for _, own, _ in influence.values())
    return "; ".join([*parts, *([f"priors determine {number(rest, 2)}"] if rest > 0.005 * n_params else [])])


def modal_cards(identification: Identification) -> tuple[tuple[str, str, str], ...]:
    """Key figures of a fit to modes, as (label, value, remark): largest frequency difference and least MAC; () without modes.

    The MAC is left out if it is not known for any mode.
    """
    fits = identification.modal_fits
    if not fits:
        return ()
    measured = [fit.problem.data.frequency for fit in fits]
    after, before = ([fit.fitted for fit in fits], [fit.initial for fit in fits])
    worst, worst_before = (
        max(float(np.abs(model.frequency / f - 1).max()) for model, f in zip(models, measured, strict=True))
        for models in (after, before)
    )
    difference, initial = (percent(value, 3, signed=False) for value in (worst, worst_before))
    tiles = (("Largest frequency difference", difference, f"initial {initial}"),)
    macs = [np.concatenate([model.mac for model in models]) for models in (after, before)]
    if np.isnan(macs).all():
        return tiles
    least, least_before = (float(np.nanmin(mac)) for mac in macs)
    return (*tiles, ("Least MAC of a pair", f"{least:.3f}", f"initial {least_before:.3f}"))


def ratio_table(identification: Identification) -> Table | None:
    """Table of parameter ratios if these are determined though their common scale is not; None if the scale is, too."""
    ratios = identification.mass.ratios
    if ratios is None:
        return None
    rows = [
        (f"{name} / {ratios.reference}", with_std(float(value), float(std)), f"{number(low, 5)} to {number(high, 5)}")
        for name, value, std, (low, high) in zip(
            ratios.names, ratios.values, ratios.std, ratios.ends.tolist(), strict=True
        )
    ]
    return Table(("Ratio", "Value ± std", "95\u00a0% interval"), tuple(rows), (1, 2))
