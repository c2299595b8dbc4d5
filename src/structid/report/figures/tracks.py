"""Figures of modes that are tracked from record to record."""

from __future__ import annotations

import numpy as np

from structid.core.quantities import value_words
from structid.modal.tracking import ModeTracks
from structid.report.drawing import palette
from structid.report.rendering import plot

_COLOURS = (palette.BLUE, palette.VERMILLION, palette.PURPLE, palette.INK)


def tracks_figure(tracks: ModeTracks) -> plot.Figure:
    """Figure of the relative change (%) of each tracked natural frequency over the records.

    Changes count from the first record that shows the mode; bars are one standard deviation.
    """
    number = np.arange(len(tracks.names))
    traces: list[plot.Trace] = []
    change = 100 * tracks.change
    std = 100 * np.nan_to_num(tracks.frequency_std / np.where(tracks.frequency > 0, tracks.frequency, 1.0))
    for k in range(tracks.n_tracks):
        seen, pen = np.flatnonzero(tracks.members[:, k] >= 0), plot.Pen(_COLOURS[k % len(_COLOURS)], 1.4)
        x, y, half = number[seen], change[seen, k], std[seen, k]
        texts = tuple(
            f"{tracks.names[i]}: {value_words(tracks.frequency[i, k], tracks.frequency_std[i, k])} Hz" for i in seen
        )
        label = f"{np.nanmean(tracks.frequency[:, k]):.4g} Hz"
        marker = plot.Marker("circle", 6.0, _COLOURS[k % len(_COLOURS)])
        traces.append(plot.segments((x, x), (y - half, y + half), pen))
        traces.append(plot.Curve(x.astype(float), y, pen, marker, label, hover=texts))
    panel = plot.panel(
        plot.Axis("record", "", (-0.5, len(number) - 0.5), ticks=plot.named_ticks(tracks.names)),
        plot.Axis("change of frequency", "%"),
        *traces,
    )
    caption = (
        "Change of each natural frequency since the first record that shows it; bars: one standard deviation. Temperature and"
        " load move all modes alike, damage some more than others."
    )
    return plot.Figure((panel,), (900.0, 420.0), caption=caption)
