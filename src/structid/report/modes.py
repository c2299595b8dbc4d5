"""Report of `structid modes`: words and tables for the terminal, and its page with moving shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from structid.core.display import as_sentence, exact, first_warnings, percent, plural, value_words, with_std
from structid.modal.merging import MergedModes
from structid.modal.shape_uncertainty import collinearity_with_std, phase_deviation_with_std
from structid.modal.survey.survey import HARDLY_DAMPED, MODES_PAGE, ModesResult, dies_out
from structid.modal.tracking import ModeTracks
from structid.records import FrfRecord
from structid.records.stored_averages import CorrelationRecord, SpectrumRecord
from structid.report.figures.survey import (
    complexity_figure,
    damping_figure,
    mac_figure,
    mpc,
    shapes_figure,
    spectra_figure,
    stabilization_figure,
    tracks_figure,
)
from structid.report.page import Page, Table, printed, provenance_table
from structid.similarity import mac

_HEADER = (
    "mode", "frequency (Hz)", "damping ratio (%)", "MPC", "MPD (deg)", "probability", "poles in the cluster",
    "cluster (Hz)", "remarks",
)  # fmt: skip
_LEFT_OUT_HEADER = ("left out (Hz)", "damping ratio (%)", "poles", "probability", "reason")
_TONES_HEADER = ("tone taken off (Hz)", "kurtosis (tone 1.5, mode 3)", "most of a channel's variance (%)", "of channel",
                 "its amplitude")  # fmt: skip
_ALIKE, _COMPLEX, _TONE = 0.95, 0.7, 2.0


def modes_text(result: ModesResult) -> list[RenderableType]:
    """Terminal text of identified modes: heading, warnings, record, method, tables and scale of the shapes.

    Tables of poles left out and of tones follow that of modes where there are any.
    """
    parts: list[RenderableType] = [Text(f"{result.title}: {plural(result.modes.n_modes, 'mode')}", style="bold")]
    parts += [Text(words, style="yellow") for words in first_warnings(result.warnings)]
    parts += [Text(fact) for fact in (record_words(result), *result.steps, method_words(result))]
    tables = (mode_table(result), left_out_table(result), tones_table(result))
    return [*parts, *(printed(table) for table in tables if table is not None), Text(scale_sentence(result))]


def merged_text(names: Sequence[str], merging: MergedModes) -> list[RenderableType]:
    """Terminal text of modes merged from several set-ups, which have the `names`: heading, warnings and table.

    `merging` has the merged modes, and their frequencies in each set-up.
    """
    modes, n = merging.modes, merging.modes.n_modes
    heading = f"{', '.join(names)}: {plural(n, 'mode')} at {plural(len(modes.channels), 'sensor')}"
    heading += modes.unknown_words
    rows = [
        (
            str(k + 1),
            value_words(modes.frequency[k], modes.std[k]),
            value_words(100 * modes.damping_ratio[k], 100 * modes.std[n + k]),
            ", ".join("-" if np.isnan(f) else f"{f:.5g}" for f in merging.frequency[:, k]),
        )
        for k in range(n)
    ]
    table = Table(("mode", "frequency (Hz)", "damping ratio (%)", "of each set-up (Hz)"), tuple(rows), (0, 1, 2))
    warnings = [Text(f"warning: {warning}", style="yellow") for warning in modes.warnings]
    left_out = [] if modes.known.all() else [Text("modes.uff is not written: UFF has no sign for an unknown entry")]
    return [Text(heading, style="bold"), *warnings, printed(table), *left_out]


def left_out_table(result: ModesResult) -> Table | None:
    """Table of stable poles that were not taken as modes, with the reason; None if there are none."""
    rows = tuple(
        (
            exact(part.frequency, 4),
            f"{100 * part.damping_ratio:.2g}",
            str(part.n_poles) if part.n_poles else "",
            _probability_words(part.probability),
            part.reason,
        )
        for part in result.identification.left_out
    )
    return Table(_LEFT_OUT_HEADER, rows, (0, 1, 2, 3)) if rows else None


def tones_table(result: ModesResult) -> Table | None:
    """Table of tones that were removed from the record before modes were identified; None if there are none.

    The channel of each row is the one with the largest share of variance from the tone.
    """
    rows = []
    for tone in result.tones:
        most = int(tone.variance_fraction.argmax())
        rows.append(
            (
                tone.frequency_words,
                f"{tone.kurtosis:.2f}",
                exact(100 * tone.variance_fraction[most], 3),
                str(tone.channels[most]),
                f"{exact(tone.amplitude[most], 3)} {tone.units[most]}",
            )
        )
    return Table(_TONES_HEADER, tuple(rows), (1, 2, 4)) if rows else None


def _probability_words(probability: float) -> str:
    return "" if np.isnan(probability) else f"{min(probability, 0.99):.2f}"


def tracks_table(tracks: ModeTracks) -> Table:
    """Table with a row for each tracked mode: number of records, first and last frequency, change, damping and least MAC.

    The change is from the first to the last record that shows the mode, damping is the median over the records, and the
    MAC compares the shape with the one that the track had last.
    """
    rows = []
    for k in range(tracks.n_tracks):
        seen = np.flatnonzero(tracks.members[:, k] >= 0)
        first, last = (value_words(tracks.frequency[i, k], tracks.frequency_std[i, k]) for i in (seen[0], seen[-1]))
        rows.append(
            (
                str(k + 1), f"{len(seen)} of {len(tracks.names)}", first, last,
                f"{100 * tracks.change[seen[-1], k]:+.2f}", f"{100 * np.nanmedian(tracks.damping_ratio[:, k]):.2g}",
                f"{np.nanmin(tracks.likeness[:, k]):.3f}",
            )
        )  # fmt: skip
    header = (
        "mode",
        "records",
        "first (Hz)",
        "last (Hz)",
        "change (%)",
        "damping ratio, median (%)",
        "least MAC with the last",
    )
    return Table(header, tuple(rows), tuple(range(len(header))))


def tracks_text(tracks: ModeTracks) -> list[RenderableType]:
    """Terminal text of tracked modes: heading, table, and the modes that appear in one record only."""
    heading = f"{plural(tracks.n_tracks, 'mode')} followed over {plural(len(tracks.names), 'record')}"
    return [
        Text(heading, style="bold"),
        printed(tracks_table(tracks)),
        *(Text(words) for words in _alone_words(tracks)),
    ]


def _alone_words(tracks: ModeTracks) -> tuple[str, ...]:
    by_record = {n: [f for number, f in tracks.alone if number == n] for n, _ in tracks.alone}
    return tuple(
        f"{tracks.names[n]} alone shows {', '.join(f'{f:.4g}' for f in values)} Hz" for n, values in by_record.items()
    )


def tracks_page(tracks: ModeTracks) -> Page:
    """Report page of modes that are tracked over several records, with its figure."""
    words = {
        "title": f"{tracks.names[0]} to {tracks.names[-1]}",
        "tracks": tracks_table(tracks),
        "alone": _alone_words(tracks),
    }
    return Page(MODES_PAGE, "tracks.html.j2", {"tracks": tracks_figure(tracks)}, words)


def mode_table(result: ModesResult) -> Table:
    """Table of identified modes with standard deviations, shape complexity, clusters of poles and remarks.

    Rows are in the order of the modes, numbered from 1; those with a remark are marked "doubtful". The columns on
    clusters are empty if the method forms none.
    """
    modes, std, n = result.modes, result.std, result.modes.n_modes
    clusters = result.identification.clusters
    notes, probability = remarks(result), result.identification.probability
    collinearity, deviation = collinearity_with_std(modes), phase_deviation_with_std(modes)
    rows: list[tuple[str, ...]] = []
    for k in range(n):
        count, spread = "", ""
        if len(clusters) == n:
            count = f"{clusters[k].size} in {plural(len(result.identification.orders), 'order')}"
            spread = with_std(float(clusters[k].frequency.mean()), clusters[k].frequency_spread)
        rows.append(
            (
                str(k + 1),
                value_words(modes.frequency[k], std[k]),
                value_words(100 * modes.damping_ratio[k], 100 * std[n + k]),
                f"{collinearity.value[k]:.3f}{_spread_words(collinearity.std[k])}",
                f"{deviation.value[k]:.1f}{_spread_words(deviation.std[k])}",
                _probability_words(probability[k]),
                count,
                spread,
                "; ".join(notes[k]),
            )
        )
    return Table(
        _HEADER, tuple(rows), tuple(range(len(_HEADER) - 1)), tuple("doubtful" if row[-1] else "" for row in rows)
    )


def _spread_words(std: float) -> str:
    return f" ± {std:.1g}" if np.isfinite(std) else ""


def remarks(result: ModesResult) -> list[list[str]]:
    """Remarks on doubtful modes as sentences: one list for each mode, empty if there is nothing to remark.

    They are on damping that is not positive or not significant, on possible tones, on shapes with an MPC below 0.7, and
    on modes whose shapes have a MAC above 0.95.
    """
    modes, n = result.modes, result.modes.n_modes
    remarks: list[list[str]] = [[] for _ in range(n)]
    alike = mac(modes.mode_shapes)
    collinearity, decaying = mpc(result), dies_out(result.identification)
    for k in range(n):
        ratio, std = modes.damping_ratio[k], result.std[n + k]
        if ratio <= 0:
            remarks[k].append("damping is not positive: noise, a tone, or motion that grows")
        elif std > ratio / 2:
            remarks[k].append("damping is not significantly different from 0")
        if ratio < HARDLY_DAMPED and not isinstance(result.record, FrfRecord) and not decaying[k]:
            remarks[k].append(_tone_words(float(result.kurtosis[k])))
        if len(modes.channels) > 1 and collinearity[k] < _COMPLEX:
            remarks[k].append("complex shape: damping, noise, or two modes in one")
        same = [str(j + 1) for j in range(n) if j != k and alike[k, j] > _ALIKE]
        if same and len(modes.channels) > 1:
            remarks[k].append(f"at the sensors the shape is that of mode {', '.join(same)}")
    return remarks


def _tone_words(kurtosis: float) -> str:
    """Remark on a mode with hardly any damping: a tone if the kurtosis of its motion is small, else a possible tone."""
    if kurtosis < _TONE:
        return f"a steady tone, as of a machine, not a mode under random forces (kurtosis {kurtosis:.2f}, tone 1.5, mode 3)"
    return "hardly damped: a machine or the mains can look like this"


def record_words(result: ModesResult) -> str:
    """Text of one line on the record that modes were identified from: kind, size, channels, frequencies."""
    record = result.record
    if isinstance(record, FrfRecord):
        return (
            f"{record.kind}, {plural(len(record.frequency), 'line')} from {exact(record.frequency[0])} to"
            f" {exact(record.frequency[-1])} Hz, {plural(len(record.outputs), 'output')},"
            f" {plural(len(record.inputs), 'input')}"
        )
    kinds = ", ".join(dict.fromkeys(record.quantities))
    if isinstance(record, SpectrumRecord):
        return (
            f"stored spectra of {plural(len(record.channels), 'channel')} of {kinds} and"
            f" {plural(len(record.references), 'reference')}, {len(record.frequency)} lines from {exact(record.frequency[0])} to"
            f" {exact(record.frequency[-1])} Hz"
        )
    if isinstance(record, CorrelationRecord):
        return (
            f"stored correlation functions of {plural(len(record.channels), 'channel')} of {kinds} and"
            f" {plural(len(record.references), 'reference')}, {len(record.values)} lags to {exact(record.lag[-1])} s"
        )
    seconds = len(record.values) / record.sampling_rate
    of_several = not {dof.unsigned for dof in result.modes.channels} <= {dof.unsigned for dof in record.channels}
    return (
        f"{'first set-up: ' if of_several else ''}{plural(len(record.channels), 'channel')} of {kinds},"
        f" {len(record.values)} samples at {exact(record.sampling_rate)} Hz, {exact(seconds)} s"
    )


def method_words(result: ModesResult) -> str:
    """Text on the method that identified the modes: model orders, range of damping ratios, band, source."""
    identification = result.identification
    words = f"method {identification.method}"
    if identification.sweep:
        orders = identification.orders
        words += f", orders {orders[0]} to {orders[-1]}" if len(orders) > 1 else f", order {orders[0]}"
        low, high = identification.options.criteria.damping_ratio
        words += f", poles with damping ratios from {percent(low, signed=False)} to {percent(high, signed=False)}"
    if result.options.band is not None:
        words += f", modes from {exact(result.options.band[0])} to {exact(result.options.band[1])} Hz"
    if result.options.frequencies is not None:
        words += f", modes asked for near {', '.join(exact(f) for f in result.options.frequencies)} Hz"
    return f"{words} ({result.modes.source})" if result.modes.source else words


def scale_sentence(result: ModesResult) -> str:
    """`ModesResult.scale_words` as a sentence."""
    return as_sentence(result.scale_words)


def std_sentence(result: ModesResult) -> str:
    """Sentence that explains the ± values in the table of modes, or says that the method gives none."""
    if result.modes.covariance is None:
        spread = " The spread over the orders of the model is not one." if result.identification.clusters else ""
        return f"This method gives no standard deviations.{spread}"
    return (
        "± is one standard deviation from the scatter of the data (first order, no bias). The spread of the cluster is"
        " another thing: how far the poles of the different model orders lie apart."
    )


def modes_page(result: ModesResult) -> Page:
    """Report page of identified modes, with its figures; figures that the method cannot provide are left out."""
    drawn = {
        "stabilization": stabilization_figure(result),
        "mode_shapes": shapes_figure(result),
        "singular_values": spectra_figure(result),
        "damping": damping_figure(result),
        "automac": mac_figure(result),
        "complexity": complexity_figure(result),
    }
    words = {
        "title": result.title,
        "found": plural(result.modes.n_modes, "mode"),
        "doubtful": bool(result.warnings) or any(remarks(result)),
        "warnings": result.warnings,
        "scale": scale_sentence(result),
        "std": std_sentence(result),
        "facts": (record_words(result), method_words(result)),
        "steps": result.steps,
        "modes": mode_table(result),
        "left_out": left_out_table(result),
        "tones": tones_table(result),
        "provenance": provenance_table(asdict(result.provenance)),
    }
    return Page(
        MODES_PAGE, "modes.html.j2", {name: figure for name, figure in drawn.items() if figure is not None}, words
    )
