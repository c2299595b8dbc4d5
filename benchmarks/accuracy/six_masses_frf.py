"""The six masses from whole FRFs: what the stored values are, whether one gain serves all, masses, and the figure.

python benchmarks/accuracy/six_masses_frf.py [--arrangements 6] [--figures FOLDER]
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import six_masses_model as six

import structid as sid
from structid.inversion.state_comparison import LATER
from structid.records.half_plane import right_half_plane
from structid.report.drawing import palette

#: Stretches that narrow resonances of something else spoil, Hz.
SPOILT = ((246, 258), (590, 610), (765, 795))
BAND = (120.0, 1190.0)
#: Tried distances of the hammer from the clamp, m, and powers of i omega between displacement and stored values.
HAMMERS = (0.005, 0.01, 0.02, 0.03, 0.04, 0.052, 0.06, 0.07)
POWERS = (0, 1, 2, 3, 4)
#: Decay of the smoothed lines in parts of their angular frequency.
LEVEL = 0.03


def receptance(found: sid.Estimate, k: int, hammer: float, frequency: np.ndarray) -> np.ndarray:
    """Of the identified model from hammer to tip."""
    structure = six.cantilever(k, six.Model(), hammer)
    unknown = six.unknowns(structure, six.Model()).started_at(found.values)
    blank = np.ones((len(frequency), 1, 1))
    ends = (f"{six.TIP}Y",), (f"{six.HAMMER}Y",)
    record = sid.FrfRecord(frequency, blank, *ends, "receptance")
    return sid.simulated_record(structure, unknown, record).values[:, 0, 0]


def quiet_lines(k: int) -> np.ndarray:
    """Every 4 Hz, away from resonances and from what spoils the record."""
    frequency = six.data()["freq_hz"][::13]
    keep = (frequency >= BAND[0]) & (frequency <= BAND[1])
    for low, high in (*SPOILT, *((0.965 * f, 1.035 * f) for f in six.poles("healthy", k)[:, 0])):
        keep &= (frequency < low) | (frequency > high)
    return np.flatnonzero(keep) * 13


def ratios(found: sid.Estimate, arrangements: Sequence[int], hammer: float, power: int) -> list[np.ndarray]:
    """log(stored / model), complex, of each arrangement between its resonances."""
    logs = []
    for k in arrangements:
        lines = quiet_lines(k)
        frequency = six.data()["freq_hz"][lines]
        model = receptance(found, k, hammer, frequency) * (2j * np.pi * frequency) ** power
        logs.append(np.log(six.values("healthy", k)[lines] / model))
    return logs


def report_kinds(found: sid.Estimate, arrangements: Sequence[int]) -> float:
    """Misfit for each power and place of the hammer; the best place for the best power."""
    print("STORED VALUES: rms of log magnitude (own gain each) | power of i omega", *POWERS)
    table = np.zeros((len(HAMMERS), len(POWERS)))
    for i, hammer in enumerate(HAMMERS):
        for j, power in enumerate(POWERS):
            logs = ratios(found, arrangements, hammer, power)
            table[i, j] = np.sqrt(np.mean(np.concatenate([(x.real - x.real.mean()) ** 2 for x in logs])))
        print(f"  hammer {100 * hammer:4.1f} cm: " + " ".join(f"{x:6.3f}" for x in table[i]), flush=True)
    i, j = np.unravel_index(np.argmin(table), table.shape)
    for power in POWERS:
        turn = np.exp(1j * np.concatenate([x.imag for x in ratios(found, arrangements, HAMMERS[i], power)]))
        mean = turn.mean()
        print(
            f"  (i omega)^{power}: constant phase {np.degrees(np.angle(mean)):7.1f} degrees, rms about it"
            f" {np.degrees(np.sqrt(np.mean(np.angle(turn / mean) ** 2))):.1f}"
        )
    print(f"  best: (i omega)^{POWERS[j]}, hammer {100 * HAMMERS[i]:g} cm from the clamp")
    return HAMMERS[i]


def report_gains(found: sid.Estimate, hammer: float) -> None:
    """Whether one gain serves all arrangements."""
    logs = ratios(found, range(24), hammer, 3)
    gains = 20 / np.log(10) * np.array([x.real.mean() for x in logs])
    spread = 20 / np.log(10) * np.array([x.real.std() for x in logs])
    print(
        f"GAIN of 24 healthy arrangements: std {gains.std(ddof=1):.2f} dB, {np.ptp(gains):.2f} dB from least to most;"
    )
    print(f"  within an arrangement the ratio of record to model varies by {spread.mean():.2f} dB over frequency")


def setup(k: int, hammer: float, start: sid.Estimate, common: bool) -> sid.Setup:
    """One arrangement's whole FRF, right of the frequency axis, with the gain as an unknown."""
    frequency = six.data()["freq_hz"]
    accelerance = -six.values("healthy", k) / (2j * np.pi * frequency)
    keep = np.flatnonzero((frequency > 15) & (frequency < 1600))
    ends = (f"{six.TIP}Y",), (f"{six.HAMMER}Y",)
    whole = sid.FrfRecord(frequency[keep], accelerance[keep, None, None], *ends, "accelerance")
    at = np.geomspace(*BAND, 60)
    smooth = right_half_plane(whole, at, LEVEL * 2 * np.pi * at)
    record = sid.FrfRecord(smooth.frequency, smooth.values, *ends, "accelerance", decay=smooth.decay)
    structure = six.cantilever(k, six.Model(), hammer)
    plain = six.unknowns(structure, six.Model())
    problem = sid.FrfProblem(structure, plain.started_at(start.values), record, "log", 1.0)
    gain = float(np.exp(np.mean(np.log(np.abs(record.values / problem.predicted(problem.theta_start))))))
    loss = sid.Unknown("loss_factor", "beam", start=six.LOSS)
    unknown = six.unknowns(structure, six.Model(), (loss,)).started_at(np.append(start.values, six.LOSS))
    channel = sid.ChannelUnknown("gain", "all", name="all" if common else f"arrangement {k + 1}", start=gain)
    return sid.Setup(structure, unknown, record, [channel], f"arrangement {k + 1}")


def report_fit(start: sid.Estimate, arrangements: Sequence[int], hammer: float, common: bool) -> sid.Identification:
    """Masses from whole FRFs."""
    options = sid.IdentifyOptions(
        residual="log", model_error=0.1, pole_free_start=False, restarts=0, n_modes=5, evaluation_band=BAND
    )
    fit = sid.identify_together([setup(k, hammer, start, common) for k in arrangements], options)
    found = fit.estimate
    print(
        f"FRFs of {len(arrangements)} arrangements, {'one gain' if common else 'own gains'}: {found.status.value}, chi-square"
        f" {found.goodness.chi_square:.0f} at errors of 10 %, {found.goodness.degrees_of_freedom} dof,"
        f" std from {found.covariance_basis}"
    )
    for name, value, std in zip(found.names, found.values, found.std, strict=True):
        if name.startswith("mass"):
            print(f"  {name:12s} {100 * value / six.LENGTH:6.2f} +- {100 * std / six.LENGTH:.2f} % of the beam")
    errors = np.array(
        [
            100 * (f.modes.frequency[:5] / six.poles("healthy", k)[:, 0] - 1)
            for f, k in zip(fit.fits, arrangements, strict=True)
        ]
    )
    print(f"  errors of f1 ... f5, all: {six.rms(errors)} %", flush=True)
    return fit


def draw_masses(path: Path) -> None:
    """Masses of the healthy state and of the three later ones, with 95 % intervals."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    healthy = six.fitted("healthy", range(24), six.Model())
    shown = [("healthy", healthy, "")] + [
        (f"{loss:g} % lost", six.both_states(state, range(24), six.Model())[0], LATER)
        for state, loss in six.STATES.items()
    ]
    for place, (words, found, tail) in enumerate(shown):
        index = [found.names.index(f"mass[{m}]{tail}") for m in six.MASSES]
        value, ends = found.values[index], found.interval()[index]
        axes.errorbar(
            np.arange(1, 7) + 0.14 * (place - 1.5),
            100 * value / six.LENGTH,
            100 / six.LENGTH * np.abs(ends.T - value),
            fmt="osD^"[place],
            color=(palette.BLACK, palette.SKY, palette.ORANGE, palette.VERMILLION)[place],
            capsize=3,
            label=words,
        )
    axes.set_ylim(0)
    axes.set_xticks(range(1, 7), [f"m{j}\n{5 * j} cm" for j in range(1, 7)])
    axes.set_xlabel("mass and its nominal distance from the clamp")
    axes.set_ylabel("mass, % of the beam's")
    axes.grid(axis="y", color=palette.GRID)
    axes.legend(ncols=4, loc="upper left", bbox_to_anchor=(0, 1.13), frameon=False)
    figure.savefig(path, dpi=130)


def draw_frf(path: Path, hammer: float, k: int = 23) -> None:
    """An arrangement beside the model that the others gave; only its gain is fitted."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found = six.fitted("healthy", [other for other in range(24) if other != k], six.Model())
    (logs,) = ratios(found, [k], hammer, 3)
    frequency = six.data()["freq_hz"]
    shown = (frequency >= 15) & (frequency <= 1300)
    frequency, stored = frequency[shown], six.values("healthy", k)[shown]
    model = -receptance(found, k, hammer, frequency) * (2j * np.pi * frequency) ** 3 * np.exp(logs.real.mean())
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(8, 5.5), sharex=True, height_ratios=(2, 1), layout="constrained"
    )
    for values, colour, words, style in (
        (stored, palette.MEASURED, "measured", "-"),
        (model, palette.FITTED, "predicted from the 23 others", "--"),
    ):
        upper.plot(frequency, 20 * np.log10(np.abs(values)), style, color=colour, label=words, lw=1.2)
        lower.plot(frequency, np.angle(values, deg=True), style, color=colour, lw=1.0)
    upper.set_ylabel("magnitude as stored, dB")
    lower.set_ylabel("phase, degrees")
    lower.set_yticks((-180, -90, 0, 90, 180))
    lower.set_xlabel("frequency, Hz")
    for axes in (upper, lower):
        axes.grid(color=palette.GRID)
    upper.legend(loc="lower right")
    figure.savefig(path, dpi=130)


def main() -> None:
    """Print the tables, and draw where a folder is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arrangements", type=int, default=6, help="how many whole FRFs are fitted together")
    parser.add_argument("--figures", type=Path, help="folder for the figures")
    chosen = parser.parse_args()
    found = six.fitted("healthy", range(24), six.Model())
    hammer = report_kinds(found, range(0, 24, 6))
    report_gains(found, hammer)
    if chosen.figures:
        draw_masses(chosen.figures / "six_masses.png")
        draw_frf(chosen.figures / "six_masses_frf.png", hammer)
    for common in (False, True):
        report_fit(found, range(chosen.arrangements), hammer, common)


if __name__ == "__main__":
    main()
