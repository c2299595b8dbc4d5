"""Tables of the report on records of modes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from structid.core.display import plural
from structid.core.quantities import NOTHING, likeness, number, percent, with_std
from structid.identification.identified import Identification
from structid.report.tables import Table

if TYPE_CHECKING:
    from structid.identification.fits.modal_fit import ModalFit

_FORMS = {
    "output": "frequencies and shapes of paired modes over their standard deviations",
    "dynamic": "smallest force that makes a measured shape a motion of the model (unmeasured places eliminated)",
}

_MAC = "frequencies over their standard deviations, and 1 - MAC of each shape over the square of `shape_error`"


def modal_table(fit: ModalFit) -> Table:
    """Table with a row for each measured mode of a record and its pair in the initial and the fitted model."""
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
    own = "with covariance" if record.covariance is not None else "no covariance"
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
        else _FORMS[problem.settings.form]
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
        ("Uncertainty", own),
        ("Error assumed besides", ", ".join(assumed) or "none"),
        ("Residual", residual + (", with damping ratios" if problem.settings.use_damping else "")),
        ("What pulls", _pull(fit)),
        ("Absolute size", scale),
    )


def _pull(fit: ModalFit) -> str:
    """Text on the number of parameters that each kind of value determines, and the share of the misfit that it makes."""
    from structid.forward.modal.problem import pull  # for records of modes alone

    found = pull(fit.problem, fit.theta)
    if not found:
        return "not told: these modes alone do not determine every parameter"
    n_params = fit.problem.unknowns.n_params
    parts = [
        f"{kind} ({plural(rows, 'value')}) determine {number(own, 2)} of {plural(n_params, 'parameter')} and make"
        f" {percent(misfit, 2, signed=False)} of the misfit"
        for kind, (rows, own, misfit) in found.items()
    ]
    rest = n_params - sum(own for _, own, _ in found.values())
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
