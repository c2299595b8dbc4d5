"""Tables 3.2 and 3.3, which hold one draw of noise each, and what the text of chapter 3 claims of noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from structid.arrays import FloatArray
from structid.reproduce.chapter_3.data import ACTUAL, ESTIMATED, N_ELEMENTS, RMS_ERROR
from structid.reproduce.chapter_3.noise import Errors, predicted_bias, repeats, rigid_body_share, sum_of_two_rms
from structid.reproduce.item import Curve, Item, Panel, Table, Verdict

_PERCENT = (5, 50, 95)
#: Samples, and seeds as a part of all, of the study of what more samples do.
_EXACT_DISPLACEMENT = {4: 0.2, 8: 0.2, 16: 0.12, 64: 0.08, 256: 0.06, 1024: 0.06}
_INTEGRATED = {4: 0.2, 8: 0.2, 16: 0.06, 64: 0.03}


def noisy_table(name: str, n_samples: int, n_seeds: int) -> Item:
    """Table 3.2 or 3.3 beside the median and the 5-95 % band of repeats under readings A and B."""
    printed, rms = ESTIMATED[n_samples], RMS_ERROR[n_samples]
    studies = {reading: repeats(reading, n_samples, n_seeds) for reading in ("A", "B")}
    values = ACTUAL * (1 + studies["A"].relative)
    low, median, high = np.percentile(values, _PERCENT, axis=0)
    inside = int(((printed >= low) & (printed <= high)).sum())
    relative = printed / ACTUAL - 1
    both, all_30 = float(sum_of_two_rms(relative)), float(np.sqrt((relative**2).mean()))
    plausible = all(
        np.percentile(study.sum_of_two, 5) <= rms <= np.percentile(study.sum_of_two, 95) for study in studies.values()
    )
    columns = ("mass m (kg/m)", "stiffness k (N/m)")
    bands = ("m, 5 %", "m, 95 %", "k, 5 %", "k, 95 %")
    band = np.column_stack([part.reshape(2, -1)[i] for i in (0, 1) for part in (low, high)])
    rows = tuple(f"element {i}" for i in range(1, N_ELEMENTS + 1))
    return Item(
        name,
        f"Estimated parameters for m = {n_samples} sampling times",
        Verdict.READING if abs(both - rms) < 5e-4 and plausible else Verdict.REFUTED,
        f"The table is one draw of noise whose seed is not known. Beside it stand medians over {n_seeds} draws (seeds 0"
        f" to {n_seeds - 1}) under reading A, in which accelerations and force have 2 % noise and displacements are"
        f" exact; {inside} of its 30 numbers lie in the 5-95 % band. Reading A multiplies every sample by 1 + 2 % n,"
        " reading B adds 2 % of the RMS of each channel; the table cannot tell them apart."
        f"\nThe printed RMS error {rms} is the sum of the RMS over the masses and the RMS over the stiffnesses,"
        f" {both:.4f}; the RMS over all 30 is {all_30:.4f}. That definition is an inference, from both tables."
        "\nThe text says that displacements are integrated from the noisy accelerations; see Claims on noise.",
        tables=(
            Table(rows, columns, printed.reshape(2, -1).T, median.reshape(2, -1).T),
            _rms_table(rms, both, all_30, studies),
            Table(rows, bands, np.full(band.shape, np.nan), band),
        ),
    )


def _rms_table(rms: float, both: float, all_30: float, studies: dict[str, Errors]) -> Table:
    """The RMS errors of the printed table, and the medians and bands of the studies around it."""
    rows = ["of the printed table"]
    computed = [[both, all_30, np.nan, np.nan, np.nan]]
    for reading, study in studies.items():
        low, median, high = np.percentile(study.sum_of_two, _PERCENT)
        rank = 100 * float((study.sum_of_two < rms).mean())
        rows.append(f"reading {reading}, median over the seeds")
        computed.append([median, float(np.median(study.of_all)), low, high, rank])
    printed = np.full((len(rows), 5), np.nan)
    printed[0, 0] = rms
    headings = ("sum of two RMS", "RMS of all 30", "sum, 5 %", "sum, 95 %", "percentile of the printed")
    return Table(tuple(rows), headings, printed, np.array(computed))


def claims(n_seeds: int, report: Callable[[float], None]) -> Item:
    """What more samples really do, with exact displacements and with displacements integrated from noisy accelerations.

    Parameters
    ----------
    n_seeds : int
        As for the tables; longer records take a part of them, at least 5.
    report : callable
        Called with the part that is done, 0 to 1.
    """
    work = [("B", m, part) for m, part in _EXACT_DISPLACEMENT.items()]
    work += [("integrated", m, part) for m, part in _INTEGRATED.items()]
    rows, results = [], []
    for done, (reading, n_samples, part) in enumerate(work):
        report(done / len(work))
        seeds = max(5, round(part * n_seeds))
        errors = repeats(reading, n_samples, seeds)
        rows.append(f"{'exact' if reading == 'B' else 'integrated'} displacements, m = {n_samples}")
        low, median, high = np.percentile(errors.of_all, _PERCENT)
        results.append([low, median, high, errors.bias, predicted_bias(reading, n_samples), seeds])
    computed = np.array(results)
    split = len(_EXACT_DISPLACEMENT)
    exact, honest = computed[:split], computed[split:]
    grows = bool((np.diff(honest[:, 1]) > 0).all())
    floor = bool(abs(exact[-1, 4] / exact[-1, 3] - 1) < 0.1 and exact[-1, 1] < 1.2 * exact[-1, 3])
    displacement, acceleration = rigid_body_share(4.0)
    headings = ("5 %", "median", "95 %", "bias", "predicted bias", "seeds")
    return Item(
        "Claims on noise",
        "More samples reduce the effect of noise; displacements integrated from accelerations; rigid-body motion",
        Verdict.REFUTED if grows and floor else Verdict.AGREES,
        "The errors are RMS over all 30 parameters. With exact displacements the error falls with m only down to a"
        f" bias floor of {100 * exact[-1, 3]:.2f} %: least squares takes the noisy accelerations of its regressors as"
        f" exact, and -(B'B + N)^-1 N p predicts {100 * exact[-1, 4]:.2f} %. Beyond about 64 samples more of them do not"
        " help."
        "\nWith displacements really integrated twice from accelerations that carry 2 % noise every 1 ms, as the text"
        f" has it, the error grows with m: {honest[0, 1]:.2g} at m = 4, {honest[1, 1]:.2g} at m = 8 and"
        f" {honest[-1, 1]:.2g} at m = {list(_INTEGRATED)[-1]}, where nearly nothing is left of the stiffnesses. Tables"
        " 3.2 and 3.3 cannot come from such displacements."
        f"\nSeeds are 0 to the number in the last column less 1. Rigid-body motion holds {100 * displacement:.0f} % of"
        f" the mass-weighted mean square of the displacement over 0-4 s, and {100 * acceleration:.0f} % of that of the"
        " acceleration; 'not significantly excited' is so for the latter only.",
        tables=(Table(tuple(rows), headings, np.full(computed.shape, np.nan), computed),),
        panels=(_panel(exact, honest),),
    )


def _panel(exact: FloatArray, honest: FloatArray) -> Panel:
    curves = []
    for label, samples, part in (
        ("exact displacements", _EXACT_DISPLACEMENT, exact),
        ("integrated displacements", _INTEGRATED, honest),
    ):
        m = np.array(list(samples), dtype=np.float64)
        curves.append(Curve(f"{label}, median", m, part[:, 1], part[:, 0], part[:, 2]))
        curves.append(Curve(f"{label}, predicted bias", m, part[:, 4]))
    title, x_label = "Error of least squares against the number of samples", "samples m"
    return Panel(title, x_label, "RMS relative error of 30 parameters", tuple(curves), log_y=True)
