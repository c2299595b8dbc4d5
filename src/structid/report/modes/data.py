"""The numbers behind the figures of modes, the same for the page and the PNG files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.modal.survey.survey import ModesResult
from structid.records import FrfRecord
from structid.report.text import DASH, unit_text
from structid.similarity import mac

#: What a pole of the sweep is: shut out by the criteria, alone, in the cluster of a mode, or the mode itself.
OUTSIDE, ALONE, CLUSTERED, CHOSEN = 0, 1, 2, 3
KIND_NAMES = ("outside the criteria", "not in a cluster", "in the cluster of a mode", "the mode itself")
#: Modes that have a plot of their own.
MOST_SHAPES = 24
_MOST_LINES = 2400


@dataclass(frozen=True, eq=False)
class SweepPoles:
    """Every pole of every order.

    Attributes
    ----------
    frequency, damping_ratio : (n_poles,) float arrays
    order, kind : (n_poles,) int arrays
    """

    frequency: FloatArray
    damping_ratio: FloatArray
    order: IntArray
    kind: IntArray


def sweep_poles(result: ModesResult) -> SweepPoles | None:
    """The poles of the stabilization diagram; None where the method has none."""
    found = result.identification
    if not found.sweep:
        return None
    kinds = []
    for poles in found.sweep:
        kind = np.full(len(poles.poles), OUTSIDE)
        kind[found.options.criteria.indices(poles)] = ALONE
        kinds.append(kind)
    for cluster in found.clusters:
        for number, index in zip(cluster.number, cluster.index, strict=True):
            kinds[number][index] = CLUSTERED
        kinds[cluster.number[cluster.chosen]][cluster.index[cluster.chosen]] = CHOSEN
    if not found.clusters:
        _mark_single(result, kinds)
    return SweepPoles(
        np.concatenate([poles.frequency for poles in found.sweep]),
        np.concatenate([poles.damping_ratio for poles in found.sweep]),
        np.repeat([poles.order for poles in found.sweep], [len(poles.poles) for poles in found.sweep]),
        np.concatenate(kinds),
    )


def _mark_single(result: ModesResult, kinds: list[IntArray]) -> None:
    """The poles nearest to the modes, where there is one order and no cluster."""
    sweep = result.identification.sweep
    for f, ratio in zip(result.modes.frequency, result.modes.damping_ratio, strict=True):
        gaps = [np.abs(p.frequency / f - 1) + np.abs(p.damping_ratio - ratio) for p in sweep]
        which = int(np.argmin([gap.min(initial=np.inf) for gap in gaps]))
        kinds[which][int(gaps[which].argmin())] = CHOSEN


def view(result: ModesResult) -> tuple[float, float]:
    """The part of the frequency axis that is shown first, Hz."""
    lines, modes = result.spectra.frequency, result.modes.frequency
    high = min(float(lines[-1]), 1.5 * float(modes.max(initial=0.0)) or float(lines[-1]))
    low = 0.0
    if isinstance(result.record, FrfRecord) and len(modes) and lines[0] > 0.3 * modes.min():
        low = float(lines[0])
    if result.options.band is not None:
        low, wanted = result.options.band
        high = min(float(lines[-1]), wanted * 1.05)
        low = max(0.0, low - 0.05 * (high - low))
    return low, high


def mode_labels(result: ModesResult) -> list[tuple[float, str]]:
    """Where the numbers of modes stand in what is shown first; neighbours that would touch share a place."""
    low, high = view(result)
    labels: list[tuple[float, list[int]]] = []
    for k, f in enumerate(result.modes.frequency.tolist()):
        if not low <= f <= high:
            continue
        if labels and f - labels[-1][0] < 0.022 * (high - low):
            labels[-1][1].append(k + 1)
        else:
            labels.append((f, [k + 1]))
    return [(f, ",".join(map(str, group)) if len(group) < 4 else f"{group[0]}{DASH}{group[-1]}") for f, group in labels]


def thinned_lines(result: ModesResult, n_values: int = 3) -> tuple[FloatArray, FloatArray]:
    """Frequencies and the first singular values: all lines, or the largest of neighbours where there are too many."""
    frequency, values = result.spectra.frequency, result.spectra.values[:, :n_values]
    step = -(-len(frequency) // _MOST_LINES)
    if step == 1:
        return frequency, values
    whole = len(frequency) // step * step
    grouped = values[:whole].reshape(-1, step, values.shape[1])
    return frequency[:whole].reshape(-1, step).mean(axis=1), grouped.max(axis=1)


def spectrum_limits(result: ModesResult) -> tuple[float, float]:
    """Least and greatest value on the logarithmic axis, in what is shown first."""
    low, high = view(result)
    if low == 0 and result.modes.n_modes:  # drift stands above every mode, and would set the scale
        low = 0.25 * float(result.modes.frequency[0])
    inside = (result.spectra.frequency >= low) & (result.spectra.frequency <= high)
    values = result.spectra.values[inside, :3] if inside.any() else result.spectra.values[:, :3]
    positive = values[values > 0]
    if not positive.size:
        return 0.1, 10.0
    top = float(positive.max())
    return max(float(positive.min()), 1e-9 * top) / 2, 3 * top


def auto_mac(result: ModesResult) -> FloatArray:
    """MAC of every mode with every other, (n_modes, n_modes)."""
    return mac(result.modes.mode_shapes)


def turned_shapes(result: ModesResult) -> ComplexArray:
    """Shapes with largest entry of size 1, turned so that most of each is real, signs of the channels as measured."""
    shapes = np.asarray(result.modes.mode_shapes, dtype=np.complex128)
    shapes = shapes * np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=0)))
    return np.asarray(shapes / np.abs(shapes).max(axis=0))


def spectrum_label(result: ModesResult) -> str:
    """Name of the axis of spectra."""
    return f"singular values ({unit_text(result.spectra.unit)})"
