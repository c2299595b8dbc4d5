"""What the report tells of records of modes, as rows of text and plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.identification.identified import Identification
from structid.identification.modal_fit import ModalFit
from structid.report.figures.data import NORMAL_95
from structid.report.identification.tables import Table
from structid.report.text import NOTHING, counted, number, percent, with_std

_FORMS = {
    "output": "frequencies and shapes of paired modes over their standard deviations",
    "dynamic": "smallest force that makes a measured shape a motion of the model (unmeasured places eliminated)",
}


@dataclass(frozen=True, eq=False)
class ModalRows:
    """Measured modes beside those of the model.

    Attributes
    ----------
    number : (n_modes,) int array
        As measured, from 1.
    initial, fitted : (n_modes,) float arrays
        Model frequency over measured frequency, less 1.
    half : (n_modes,) float array
        Half the 95 % interval of the measured frequency, in parts of it.
    initial_mac, fitted_mac : (n_modes,) float arrays
    """

    number: np.ndarray
    initial: FloatArray
    fitted: FloatArray
    half: FloatArray
    initial_mac: FloatArray
    fitted_mac: FloatArray


def modal_rows(fit: ModalFit) -> ModalRows:
    """What the figure of one record of modes shows."""
    problem = fit.problem
    measured = problem.data.frequency
    return ModalRows(
        problem.data.measured + 1,
        fit.initial.frequency / measured - 1,
        fit.fitted.frequency / measured - 1,
        NORMAL_95 * problem.data.frequency_std / measured,
        fit.initial.mac,
        fit.fitted.mac,
    )


def modal_table(fit: ModalFit) -> Table:
    """Every measured mode with its pair in the model, before and after."""
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
                percent(after / f - 1), number((after - f) / std, 2), f"{fit.initial.mac[i]:.3f}",
                f"{fit.fitted.mac[i]:.3f}", str(int(fit.fitted.number[i]) + 1),
                percent(float(problem.record.damping_ratio[mode]), 3, signed=False),
                percent(float(fit.fitted.damping_ratio[i]), 3, signed=False), angle if size > 1 else NOTHING,
            )
        )  # fmt: skip
    return Table(header, tuple(rows), tuple(range(12)))


def modal_facts(fit: ModalFit, masses_unknown: bool) -> tuple[tuple[str, str], ...]:
    """What was measured, as pairs of a label and a text."""
    problem, record = fit.problem, fit.measured
    own = "with covariance" if record.covariance is not None else "no covariance"
    assumed = [
        f"{percent(value, 3, signed=False)} of each {what}"
        for value, what in ((problem.frequency_error, "frequency"), (problem.damping_error, "damping ratio"))
        if value
    ]
    assumed += [f"{percent(problem.shape_error, 3, signed=False)} of the largest shape entry"] * bool(
        problem.shape_error
    )
    f = record.frequency[problem.data.measured]
    scale = (
        "modes give ratios of stiffness to mass only; kilograms rest on "
        + ("known masses, priors or other records" if masses_unknown else "the masses of the model")
    )  # fmt: skip
    return (
        ("Source", record.source or "not stated"),
        ("Modes used", f"{counted(len(f), 'mode')}, {number(float(f[0]))} to {number(float(f[-1]))} Hz"),
        ("Sensors", ", ".join(map(str, record.channels))),
        ("Uncertainty", own),
        ("Error assumed besides", ", ".join(assumed) or "none"),
        ("Residual", _FORMS[problem.form] + (", with damping ratios" if problem.use_damping else "")),
        ("Absolute size", scale),
    )


def modal_cards(identification: Identification) -> tuple[tuple[str, str, str], ...]:
    """Largest difference in frequency and least MAC over all records of modes: label, value and a remark."""
    rows = [modal_rows(fit) for fit in identification.modal_fits]
    if not rows:
        return ()
    after, before = (
        max(float(np.abs(r).max()) for r in part) for part in zip(*((r.fitted, r.initial) for r in rows), strict=True)
    )
    best, worst = (
        min(float(m.min()) for m in part) for part in zip(*((r.fitted_mac, r.initial_mac) for r in rows), strict=True)
    )
    return (
        (
            "Largest frequency difference",
            percent(after, 3, signed=False),
            f"initial {percent(before, 3, signed=False)}",
        ),
        ("Least MAC of a pair", f"{best:.3f}", f"initial {worst:.3f}"),
    )


def ratio_table(identification: Identification) -> Table | None:
    """Ratios that remain where a common scale is free; None where none is."""
    found = identification.ratios
    if found is None:
        return None
    rows = [
        (f"{name} / {found.reference}", with_std(float(value), float(std)), f"{number(low, 5)} to {number(high, 5)}")
        for name, value, std, (low, high) in zip(found.names, found.values, found.std, found.ends.tolist(), strict=True)
    ]
    return Table(("Ratio", "Value ± std", "95\u00a0% interval"), tuple(rows), (1, 2))
