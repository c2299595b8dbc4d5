"""Modes of free or ambient motion by any method that forms a block Hankel matrix of the outputs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.errors import InputError, NoModesError
from structid.modal.close_modes import NOT_TOLD_APART, close_mode_notes, repeated_modes
from structid.modal.correlations import ScaledMotion, displacement_rows, outputs
from structid.modal.method import LeftOut, ModalIdentification, ModalOptions, by_rising_frequency
from structid.modal.modal_record import ModalChanges, ModalRecord, unit_largest
from structid.modal.poles.poles import Poles, frequency_damping_slope, modal_phase_collinearity
from structid.modal.poles.stabilization import LIKELY, UNLIKELY, Cluster, clusters, likely_modes
from structid.modal.subspace.decay_fit import (
    decay_fit,
    decay_modes,
    energy_fractions,
    is_left_over,
    is_near,
    left_over,
    noise_strength,
    schwarz,
    stands_out,
)
from structid.modal.subspace.kernel import Subspace, poles_of_orders
from structid.modal.subspace.methods import pencil, ssi_cov, ssi_data
from structid.modal.subspace.pole_uncertainty import (
    FreeDecay,
    SingularVectorChanges,
    deviations,
    free_decay,
    frequency_widening,
    overlapping_batches,
    pole_deviations,
)
from structid.records import TimeRecord
from structid.similarity import mac

SUBSPACE_METHODS: dict[str, Callable[..., Subspace]] = {"pencil": pencil, "ssi_cov": ssi_cov, "ssi_data": ssi_data}
_REFINED = ("pencil",)
MAX_ORDER = 60
BLOCK_ROWS = 30
_STATES_A_MODE = 4  # of the greatest order; with fewer, orders are doubled
_MOST_STATES, _MOST_ORDERS = 240, 60  # to which orders are doubled, and how many: distances of all poles take memory
_CERTAIN = 0.005  # of a frequency: standard deviation below which a mode of a free decay is kept, however weak
_SAME = 0.01  # of a frequency: distance below which a pole with damping takes the place of one without
_LOST = 0.1  # of the noise left: amplitude of a free decay below which it tells nothing more
_TRIES = 4  # poles in a row that explain a free decay no better, after which no more are tried
ONE_PHASE = 0.5  # modal phase collinearity below which a stable pole of random motion is no mode
_PERHAPS = 0.3  # probability of being a mode from which on poles that are none are listed
_RATHER = (
    0.5  # probability from which on poles are a mode by their deviations, or a surer pole is looked for in other orders
)
_POSSIBLE = 0.05  # probability without deviations below which poles are no mode, whatever their deviations
_NEIGHBOUR = 0.2  # part of the frequency within which a pole of noise may have the shape of a mode
_ONE_SHAPE = 0.8  # MAC above which a pole in the bandwidth of a mode is one more of this mode
_STEADY, _FEWEST_DYING = (
    0.1,
    3,
)  # of the usual damping ratio, that of a tone at most; modes that die out and tell the usual
_WIDE, _MORE_ORDERS = 1.5, 4  # of the least deviation of a frequency: what lets other orders be looked at, and how many
_STRONG = 0.01  # of the energy of a free decay: part from which on a mode is kept, however uncertain


def subspace_modes(
    records: TimeRecord | Sequence[TimeRecord], options: ModalOptions, method: str
) -> ModalIdentification:
    """Modes of time records by a method of `SUBSPACE_METHODS` ("pencil", "ssi_cov" or "ssi_data"); see `identify_modes`."""
    return _modes(outputs(records), options, method)


def _modes(data: ScaledMotion, options: ModalOptions, method: str, is_decay: bool = False) -> ModalIdentification:
    """Modes of records by the subspace `method` (pencil, ssi_cov or ssi_data), with poles of all orders and clusters.

    Without `options.orders` the greatest order is doubled while models are crowded. A free decay that falls below the
    noise is cut there and identified anew, unless `is_decay` says that the records were already cut. Without
    `options.frequencies`, modes that do not stand out of the noise are left out.

    Raises
    ------
    NoModesError
        If no pole is stable and meets the criteria.
    InputError
        If `orders` or `block_rows` do not suit the records.
    """
    rows = _block_rows(data, options.block_rows)
    greatest, n_instants = MAX_ORDER, sum(len(y) - 2 * rows - 1 for y in data.series)
    most = min(n_instants, _MOST_STATES)
    while True:
        wanted = _orders(data, rows, options.orders, greatest)
        subspace = SUBSPACE_METHODS[method](data, rows, max(wanted), n_pieces=max(options.n_pieces, 1))
        wanted = [n for n in wanted if n <= subspace.max_order] if options.orders is None else wanted
        sweep = poles_of_orders(subspace, wanted)
        selection = picked_poles(sweep, data.scale, options)
        is_crowded = options.orders is None and wanted[-1] == greatest and _is_crowded(selection, greatest)
        if not is_crowded or 2 * greatest > most:
            break
        greatest *= 2
    picked, clusters, notes, others = selection.places, selection.clusters, selection.notes, selection.others
    if is_crowded and greatest == _MOST_STATES:
        notes.append(
            f"models of {_MOST_STATES} states have fewer than {_STATES_A_MODE} for each mode, so that modes may be merged or"
            " missing: identify bands of frequencies one by one (filtered and resampled), or give `orders`"
        )
    if not picked:
        raise NoModesError(
            "`records` show no mode that is stable over `orders` and meets `criteria`; widen the criteria, raise "
            "`block_rows` or the greatest order, or measure longer"
        )
    motion = free_decay(data, poles_of(sweep, picked))
    shorter = _until_noise(data, motion, 8 * rows) if motion.explains_most and not is_decay else None
    if shorter is not None:
        result = _modes(shorter, options, method, is_decay=True)
        words = f"after {shorter.duration:.3g} s the free decay is lost in the noise: modes are from the time before (`stop`)"
        return replace(result, modes=replace(result.modes, warnings=(words, *result.modes.warnings)))
    automatic = bool(clusters) and options.frequencies is None
    if automatic and method in _REFINED and options.refine and (is_decay or motion.explains_most):
        picked, clusters, motion = _with_left_over(data, sweep, picked, clusters, motion, options, notes)
    if not motion.explains_all and (poles_of(sweep, picked).real >= 0).any():
        options = replace(options, criteria=options.criteria.damped)
        picked, clusters, notes, others = _damped(sweep, data.scale, options, poles_of(sweep, picked))
        motion = free_decay(data, poles_of(sweep, picked))
    if automatic and motion.explains_all:
        picked, clusters, motion = _standing_out(data, sweep, picked, clusters, motion, notes)
    changes = _pole_changes(subspace, sweep, picked, clusters, motion)
    if automatic and changes is not None and not motion.explains_all:
        piece = data.seconds / len(subspace.windows)
        least = LIKELY if motion.explains_most else _RATHER  # a weak pole of a decay must not pass for certain
        clusters, changes = surest_poles(subspace, sweep, clusters, changes, data.seconds, piece, least)
        if not motion.explains_most and data.n_channels > 1:  # one channel has no shape that could move
            clusters, others, changes = _told_by_deviations(subspace, sweep, clusters, others, changes, notes)
        picked, clusters, changes = by_frequency(clusters, changes)
    modes = _modal_record(subspace, sweep, picked, motion, changes, notes)
    if method in _REFINED and options.refine and motion.explains_all:
        modes = decay_modes(data, modes)
    left_out = left_out_clusters(others, modes.frequency, modes.damping_ratio) if automatic else []
    result = ModalIdentification(
        modes, method, sweep, clusters, options, by_rising_frequency(left_out), motion.explains_most
    )
    if automatic:
        result = _keep_certain_modes(data, result, motion)
    more = close_mode_notes(result.modes, data.duration, len(data.series), motion.explains_all)
    return replace(result, modes=replace(result.modes, warnings=(*result.modes.warnings, *more)))


def _until_noise(data: ScaledMotion, motion: FreeDecay, n_least: int) -> ScaledMotion | None:
    """Records cut where the free decay falls to a tenth of the noise left; None if over half of the samples would stay.

    Decay and noise are compared as root mean squares over the channels of `data`. The samples after that tell nothing
    of the modes, and their noise hides modes that die out early. `motion` is the decay and residual of each record,
    `n_least` the least number of samples to keep of each record.
    """
    series = []
    for y, decay, rest in zip(data.series, motion.decay, motion.rest, strict=True):
        noise = np.mean(np.square(rest), axis=0)
        level = np.mean(np.square(decay) / np.maximum(noise, np.finfo(float).tiny), axis=1)
        heard = np.flatnonzero(level > _LOST**2)
        series.append(y[: max(int(heard[-1]) + 1 if len(heard) else 0, n_least)])
    if sum(map(len, series)) > 0.5 * sum(map(len, data.series)):
        return None
    return replace(data, series=tuple(series))


def _with_left_over(
    data: ScaledMotion, sweep: Sequence[Poles], picked: list[tuple[int, int]], chosen_clusters: tuple[Cluster, ...],
    motion: FreeDecay, options: ModalOptions, notes: list[str],
) -> tuple[list[tuple[int, int]], tuple[Cluster, ...], FreeDecay]:  # fmt: skip
    """The chosen poles, their clusters and the free decay, with missing modes added if its residual is more than noise.

    Heavily damped modes scatter over the orders, so that their clusters are too small to be taken for modes. `picked`,
    `chosen_clusters` and `motion` are returned as they are if nothing is added.

    Parameters
    ----------
    data : ScaledMotion
    sweep : sequence of Poles
        Poles of each model order.
    picked : list of (order number, pole index)
    chosen_clusters : tuple of Cluster
    motion : FreeDecay
        The records split into free decay and residual.
    options : ModalOptions
    notes : list of str
        A warning is appended where more than noise is left.
    """
    all_clusters = clusters(sweep, data.scale, options.criteria, keep_all=True)
    candidates = np.array([sweep[c.number[c.chosen]].poles[c.index[c.chosen]] for c in all_clusters if c.size > 1])
    start = poles_of(sweep, picked)
    fit = decay_fit(data, start)
    poles = start if fit is None else fit.poles
    if fit is not None and is_near(poles, start) and not is_left_over(data, poles, candidates):
        return picked, chosen_clusters, motion
    poles = _add_candidates(data, poles, candidates)
    wider = free_decay(data, poles)
    if not wider.explains_all or is_left_over(data, poles, candidates):
        notes.append(
            "the free decay holds more than these modes and white noise: modes may be missing, and standard deviations too "
            "small. Read the part that is free motion (`start`, `stop`), or give `orders` or `frequencies`"
        )
        return picked, chosen_clusters, motion
    chosen = _nearest(sweep, poles)
    return chosen, tuple(_cluster_with_pole(sweep, all_clusters, *place) for place in chosen), wider


def _add_candidates(data: ScaledMotion, poles: ComplexArray, candidates: ComplexArray) -> ComplexArray:
    """Poles with those `candidates` (rad/s) added, strongest first, that lower Schwarz's criterion on `data`.

    All poles are refined by maximum likelihood each time, and those that no longer stand out are left out. At most four
    candidates in a row are tried without gain. `poles`, in rad/s too, and `candidates` are (n,) each.
    """
    price = schwarz(data, poles)
    while True:
        strength_left = left_over(data, poles, candidates)
        strongest = [k for k in np.argsort(-strength_left)[:_TRIES] if strength_left[k] > noise_strength(data)]
        for k in strongest:
            fit = decay_fit(data, np.append(poles, candidates[k]))
            kept = poles[:0] if fit is None else fit.poles[stands_out(data, fit.poles)]
            lower = schwarz(data, kept) if len(kept) else np.inf
            if lower < price:
                poles, price = kept, lower
                break
        else:
            return poles


def _nearest(sweep: Sequence[Poles], poles: ComplexArray) -> list[tuple[int, int]]:
    """Pairs (order number, pole index), from 0, of the pole of `sweep` nearest to each of `poles` (rad/s).

    They are in the order of `poles`. None is taken twice: a later one of `poles` gets the nearest that is left.
    """
    places = [(k, i) for k, poles_of_order in enumerate(sweep) for i in range(len(poles_of_order.poles))]
    values, chosen = np.concatenate([poles_of_order.poles for poles_of_order in sweep]), []
    for pole in poles:
        nearest = next(int(j) for j in np.argsort(np.abs(values - pole)) if places[j] not in chosen)
        chosen.append(places[nearest])
    return chosen


def _cluster_with_pole(sweep: Sequence[Poles], all_clusters: Sequence[Cluster], number: int, index: int) -> Cluster:
    """Cluster of `all_clusters` that holds the pole `index` of order number `number` in the sweep, with that pole chosen.

    If none holds it: a new cluster of that pole alone.
    """
    for cluster in all_clusters:
        here = np.flatnonzero((cluster.number == number) & (cluster.index == index))
        if len(here):
            return replace(cluster, chosen=int(here[0]))
    poles, chosen = sweep[number], np.array([index])
    return Cluster(np.array([number]), chosen, poles.frequency[chosen], poles.damping_ratio[chosen], 0)


def poles_of(sweep: Sequence[Poles], picked: Sequence[tuple[int, int]]) -> ComplexArray:
    """The picked poles of a sweep over orders, (n_modes,), rad/s."""
    return np.array([sweep[k].poles[i] for k, i in picked])


def _damped(
    sweep: Sequence[Poles], scale: FloatArray, options: ModalOptions, before: ComplexArray
) -> tuple[list[tuple[int, int]], tuple[Cluster, ...], list[str], tuple[Cluster, ...]]:
    """Chosen poles (order number, pole index) of ambient motion, their clusters, notes, and the other clusters.

    `options` hold criteria that exclude poles without damping; `before` are the poles (rad/s) chosen without this, and
    a note names those lost. `scale` (n_channels,) divides shapes before they are compared. `NoModesError` if none is
    left. `sweep` has the poles of each model order.
    """
    selection = picked_poles(sweep, scale, options)
    picked = selection.places
    omega, undamped = np.abs(poles_of(sweep, picked)), np.abs(before[before.real >= 0])
    lost = [w for w in undamped if not (np.abs(omega / w - 1) < _SAME).any()]
    listed = ", ".join(f"{w / (2 * np.pi):.4g}" for w in sorted(lost))
    words = (
        f"poles without damping, which in ambient motion are noise or the tone of a machine, are left out: {listed} Hz"
    )
    if not picked:
        raise NoModesError(f"`records` show no mode; {words}. Measure longer, or choose another method")
    notes = [*selection.notes, words] if lost else selection.notes
    return picked, selection.clusters, notes, selection.others


def _standing_out(
    data: ScaledMotion, sweep: Sequence[Poles], picked: list[tuple[int, int]], chosen_clusters: tuple[Cluster, ...],
    motion: FreeDecay, notes: list[str],
) -> tuple[list[tuple[int, int]], tuple[Cluster, ...], FreeDecay]:  # fmt: skip
    """The chosen poles, their clusters and the free decay, without modes that do not stand out of the noise.

    `picked` are pairs (order number, pole index); modes left out are named in `notes`. All are kept if none stands out.
    `chosen_clusters` are those of the poles, in their order. A mode stands out if its amplitudes exceed what poles
    fitted to noise reach. `sweep` has the poles of each model order, `motion` the records split into decay and
    residual.
    """
    s = poles_of(sweep, picked)
    keep = stands_out(data, s)
    if keep.all() or not keep.any():
        return picked, chosen_clusters, motion
    listed = ", ".join(f"{f:.4g}" for f in np.sort(np.abs(s[~keep])) / (2 * np.pi))
    notes.append(f"stable poles that do not stand out of the noise of the decay are left out: {listed} Hz")
    kept = np.flatnonzero(keep)
    return [picked[i] for i in kept], tuple(chosen_clusters[i] for i in kept), free_decay(data, s[kept])


def _keep_certain_modes(
    data: ScaledMotion, identification: ModalIdentification, motion: FreeDecay
) -> ModalIdentification:
    """Identification without modes whose frequency is less certain than their half-power bandwidth, or 2 / T if larger.

    The measure is the standard deviation of the frequency; T is the duration of the longest record of `data`, and the
    limit is half as large for modes with a probability below 0.3; modes without a deviation stay. Unless `motion`, the
    free decay in the records, explains all, duplicates and modes with a phase collinearity below 0.5 are left out too.
    Where it explains most and `options.deviation` is not set, a mode must also have a deviation of at most 0.5 % or 1 %
    of the energy, and be no tone.
    """
    modes, std = identification.modes, identification.modes.frequency_std
    doubtful = identification.probability < _PERHAPS
    width = np.where(doubtful, 1, 2) * np.maximum(np.abs(modes.damping_ratio) * modes.frequency, 1 / data.duration)
    identification = identification.kept(
        ~(std > width), "stable poles whose frequency is less certain than their bandwidth"
    )
    if not motion.explains_all:
        words = "stable poles of the shape and, to within their deviations, the frequency of another"
        identification = identification.kept(~repeated_modes(identification.modes), words)
        is_one = ~(modal_phase_collinearity(identification.modes.mode_shapes.astype(complex)) < ONE_PHASE)
        identification = identification.kept(
            is_one, "stable poles without a shape in one phase, as at the edge of a filter or of the forces"
        )
    modes = identification.modes
    if not motion.explains_most or identification.options.deviation is not None:
        return identification
    weak = (modes.frequency_std > _CERTAIN * modes.frequency) & (energy_fractions(data, modes.poles) < _STRONG)
    words = (
        f"modes of the decay with a standard deviation of frequency above {100 * _CERTAIN:g} % and less than"
        f" {100 * _STRONG:g} % of the energy"
    )
    identification = identification.kept(~weak, words)
    return identification.kept(
        ~_is_steady(data, identification.modes),
        "weak poles that stay while other modes die out, as the tone of a machine or the mains,",
    )


def _is_steady(data: ScaledMotion, modes: ModalRecord) -> NDArray[np.bool_]:
    """Mask (n_modes,) of steady tones in a free decay: weak modes with far less damping than modes that die out.

    Weak is below 1 % of the energy of `data`; a mode dies out if its damping ratio exceeds 1.96 standard deviations;
    far less damping is a ratio that with 1.96 standard deviations added stays below a tenth of the median ratio of
    modes that die out. All false if fewer than three die out.
    """
    ratio, std = modes.damping_ratio, np.nan_to_num(modes.std[modes.n_modes :])
    dying = ratio > NOT_TOLD_APART * std
    steady = np.zeros(modes.n_modes, dtype=bool)
    if dying.sum() >= _FEWEST_DYING:
        usual = float(np.median(ratio[dying]))
        steady = (np.abs(ratio) + NOT_TOLD_APART * std < _STEADY * usual) & (
            energy_fractions(data, modes.poles) < _STRONG
        )
    return steady


def _block_rows(data: ScaledMotion, wanted: int | None) -> int:
    """Number of block rows of the Hankel matrix: `wanted`, or by default enough for the largest model order.

    The default has room for 120 states (twice the greatest order of 60), and is at least 30, but at most an eighth of
    the samples of the shortest record of `data`. `InputError` if the number is below 2, so by default if a record has
    fewer than 16 samples.
    """
    shortest = min(len(y) for y in data.series)
    if wanted is not None:
        if wanted < 2:
            raise InputError(f"`block_rows` must be at least 2, got {wanted}; a shift needs two samples")
        return wanted
    few_channels = -(-2 * MAX_ORDER // data.n_channels)
    rows = min(max(BLOCK_ROWS, few_channels), shortest // 8)
    if rows < 2:
        raise InputError(f"every record must hold at least 16 samples, got {shortest}; measure longer")
    return rows


def _is_crowded(selection: PickedPoles, greatest: int) -> bool:
    """True if models of `greatest` states have fewer than four for each mode, so that modes may be merged or missing.

    Clusters that were not taken count as modes too unless they are unlikely: where states are few, modes are stable over a few
    orders only.
    """
    perhaps = sum(cluster.probability >= UNLIKELY for cluster in selection.others)
    return _STATES_A_MODE * (len(selection.clusters) + perhaps) > greatest


def _orders(data: ScaledMotion, rows: int, wanted: Sequence[int] | None, greatest: int) -> list[int]:
    """Model orders to try, increasing: those `wanted`, or else at most 60 even ones, in even steps up to `greatest`.

    `InputError` if there are none, one is below 1 or exceeds the matrix. `rows` is the number of block rows, with room
    for (rows - 1) * n_channels states; the default ends there.
    """
    room = (rows - 1) * data.n_channels
    step = max(2, 2 * math.ceil(greatest / (2 * _MOST_ORDERS)))
    orders = list(range(step, min(greatest, room) + 1, step)) if wanted is None else sorted({int(n) for n in wanted})
    if not orders or orders[0] < 1 or orders[-1] > room:
        raise InputError(
            f"`orders` must lie from 1 to {room} for {data.n_channels} channels and {rows} block rows, got "
            f"{orders if len(orders) < 5 else f'{orders[0]} to {orders[-1]}'}; raise `block_rows`"
        )
    return orders


@dataclass(frozen=True, eq=False)
class PickedPoles:
    """The pole that was chosen for each mode, sorted by frequency.

    Attributes
    ----------
    places : list of (int, int)
        Number of the order in the sweep, and index of the pole.
    clusters : tuple of Cluster
        The poles of all orders behind each mode; empty for a single order.
    notes : list of str
        Words on doubtful modes.
    others : tuple of Cluster
        Stable poles that are no mode.
    """

    places: list[tuple[int, int]]
    clusters: tuple[Cluster, ...] = ()
    notes: list[str] = field(default_factory=list)
    others: tuple[Cluster, ...] = ()


def picked_poles(sweep: Sequence[Poles], scale: FloatArray, options: ModalOptions) -> PickedPoles:
    """Poles of the `sweep` over orders chosen as modes: those nearest to `options.frequencies`, or of likely clusters.

    The result has pairs (order number, pole index) from 0, by rising frequency, the cluster of each, notes, and the
    other clusters. A note names a frequency whose nearest cluster is more than 2 % away. There are no pairs if no pole
    is stable. A sweep with a single order gives all its poles that meet the criteria, or the nearest, without clusters.
    `scale` (n_channels,) divides shapes before they are compared.
    """
    criteria, frequencies = options.criteria, options.frequencies
    if len(sweep) == 1:
        places = [(0, int(i)) for i in criteria.indices(sweep[0])]
        if frequencies is not None:
            f = sweep[0].frequency
            places = (
                sorted({min(places, key=lambda p: abs(f[p[1]] - wanted)) for wanted in frequencies}) if places else []
            )
        return PickedPoles(places)
    every = clusters(sweep, scale, criteria, keep_all=True)
    chosen = every if frequencies is not None else likely_modes(every)
    notes: list[str] = []
    if frequencies is not None and chosen:
        nearest = [min(chosen, key=lambda c: abs(c.frequency[c.chosen] - f)) for f in frequencies]
        for wanted, cluster in zip(frequencies, nearest, strict=True):
            got = cluster.frequency[cluster.chosen]
            if abs(got / wanted - 1) > 0.02:
                notes.append(f"the stable pole nearest to {wanted:g} Hz is at {got:.4g} Hz; look at the spectrum")
        chosen = tuple(sorted(set(nearest), key=lambda c: float(c.frequency[c.chosen])))
    places = [cluster.place for cluster in chosen]
    others = tuple(cluster for cluster in every if cluster.place not in places)
    return PickedPoles(places, chosen, notes, others)


def left_out_clusters(clusters: Sequence[Cluster], frequency: FloatArray, damping_ratio: FloatArray) -> list[LeftOut]:
    """Clusters with a probability of 0.3 or more that were not taken for a mode, as `LeftOut` with the reason.

    `frequency` (Hz) and `damping_ratio`, (n_modes,) each, are of the modes taken; clusters within half the half-power
    bandwidth or 1 % of the frequency of one of these are passed over.
    """
    width = np.maximum(np.abs(damping_ratio), _SAME) * frequency
    listed = []
    for cluster in clusters:
        f, ratio = float(cluster.frequency[cluster.chosen]), float(cluster.damping_ratio[cluster.chosen])
        if not cluster.probability >= _PERHAPS or (np.abs(frequency - f) <= width).any():
            continue
        why = "too few or too far apart" if np.isnan(cluster.excess) else "too few, too far apart or too uncertain"
        reason = f"poles of {cluster.size} orders, {why} for a mode; `frequencies` takes them"
        listed.append(LeftOut(f, ratio, cluster.size, cluster.probability, reason))
    return listed


@dataclass(frozen=True, eq=False)
class PoleChanges:
    """Changes of the poles and shapes of modes, each change that of one deviation of the subspace matrix.

    Attributes
    ----------
    spread : SingularVectorChanges
        The deviations.
    poles : (n_changes, n_modes) complex array
        rad/s.
    shapes : (n_changes, n_channels, n_modes) complex array
        The parts along the shapes themselves mean nothing.
    """

    spread: SingularVectorChanges
    poles: ComplexArray
    shapes: ComplexArray

    def of(self, modes: Sequence[int]) -> PoleChanges:
        """Changes of the `modes` (numbers from 0), in this order."""
        return PoleChanges(self.spread, self.poles[:, modes], self.shapes[:, :, modes])

    def with_changes(self, poles: ComplexArray, shapes: ComplexArray) -> PoleChanges:
        """Changes of these modes, and behind them of further ones, by the same deviations."""
        return PoleChanges(
            self.spread,
            np.concatenate([self.poles, poles], axis=1),
            np.concatenate([self.shapes, shapes], axis=2),
        )


def _pole_changes(
    subspace: Subspace,
    sweep: Sequence[Poles],
    picked: Sequence[tuple[int, int]],
    clusters: Sequence[Cluster],
    motion: FreeDecay,
) -> PoleChanges | None:
    """Changes of the poles and shapes of the modes `picked` (order number, pole index) by the scatter of the data.

    The scatter is that of noise where `motion` is a free decay throughout, else that between windows of the records,
    through the matrix of `subspace`. None for fewer than two windows, or if the method gives no parts of its matrix.
    `sweep` are the poles of all orders; `clusters` tell which further orders the deviations must serve.
    """
    numbers = [k for k, _ in picked] if motion.explains_all else [k for k, _ in picked] + numbers_of(clusters)
    highest = max(sweep[k].order for k in numbers) if motion.explains_most else sweep[-1].order
    spread = deviations(subspace, highest, motion, len(picked))
    return None if spread is None else PoleChanges(spread, *changes_of_poles(subspace, spread, sweep, picked))


def numbers_of(clusters: Sequence[Cluster]) -> list[int]:
    return sorted({k for cluster in clusters for k in cluster.number.tolist()})


def surest_poles(
    subspace: Subspace,
    sweep: Sequence[Poles],
    chosen_clusters: Sequence[Cluster],
    changes: PoleChanges,
    seconds: float,
    piece: float | None = None,
    least_probability: float = _RATHER,
) -> tuple[tuple[Cluster, ...], PoleChanges]:
    """Clusters and changes, in the same order, where a less uncertain pole of the same cluster replaces the chosen one.

    A model of high order may have a pole of noise beside that of a mode, which then is uncertain although all orders agree
    on it. Modes with a probability of `least_probability` or more, whose frequency has more than 1.5 times the least standard
    deviation that `seconds` of record allow, are looked at in up to four other orders. The surest pole of the cluster, equal
    to the chosen one within its deviations, takes its place. `seconds` is the length of all records, `piece` (s) that of a
    piece, or None where changes are not by pieces.

    References
    ----------
    Au (2014), Uncertainty law in ambient modal identification, part I: theory, Mech. Syst. Signal Process. 48, 15-33: the
    variance of a frequency f is at least zeta f / (2 pi T) in T seconds.
    """
    start = poles_of(sweep, [cluster.place for cluster in chosen_clusters])
    memory = _memory(start)

    def std(poles: ComplexArray, moved: ComplexArray) -> FloatArray:
        """Standard deviations (2, n_poles) of frequencies (Hz), then damping ratios, of `poles` (rad/s).

        `moved` (n_changes, n_poles) are the changes of the poles, rad/s; unless `piece` is None, they are first added
        up over overlapping batches of pieces.
        """
        batches = moved if piece is None else overlapping_batches(moved, moved[:, None], piece, memory)[0]
        slope = frequency_damping_slope(poles)
        both = np.concatenate([batches.real, batches.imag], axis=1) @ slope.T
        return np.asarray(np.sqrt(np.sum(both**2, axis=0)).reshape(2, -1))

    clusters, ds, dshape = list(chosen_clusters), changes.poles.copy(), changes.shapes.copy()
    least = _least_std(start, seconds)
    surest = std(start, ds)
    likely = np.array([cluster.probability >= least_probability for cluster in chosen_clusters])
    tries = dict.fromkeys(np.flatnonzero(likely & (surest[0] > _WIDE * least)).tolist(), _MORE_ORDERS)
    numbers = [k for m in tries for k in chosen_clusters[m].number.tolist()]
    for k in sorted(set(numbers), key=lambda k: (-numbers.count(k), k)):
        modes = [
            m
            for m, left in tries.items()
            if left and k in chosen_clusters[m].number and chosen_clusters[m].place[0] != k
        ]
        if not modes:
            continue
        tries |= {m: tries[m] - 1 for m in modes}
        member = [int(np.flatnonzero(chosen_clusters[m].number == k)[0]) for m in modes]
        index = [int(chosen_clusters[m].index[j]) for m, j in zip(modes, member, strict=True)]
        moved, shapes = pole_deviations(subspace, changes.spread, sweep[k].order, index)
        other_std = std(sweep[k].poles[index], moved)
        for i, (m, j) in enumerate(zip(modes, member, strict=True)):
            cluster = chosen_clusters[m]
            apart = (
                abs(cluster.frequency[j] - cluster.frequency[cluster.chosen]),
                abs(cluster.damping_ratio[j] - cluster.damping_ratio[cluster.chosen]),
            )
            if (other_std[:, i] < surest[:, m]).all() and (np.array(apart) <= other_std[:, i]).all():
                clusters[m], surest[:, m] = replace(cluster, chosen=j), other_std[:, i]
                ds[:, m], dshape[:, :, m] = moved[:, i], shapes[:, :, i]
    return tuple(clusters), PoleChanges(changes.spread, ds, dshape)


def by_frequency(
    clusters: Sequence[Cluster], changes: PoleChanges
) -> tuple[list[tuple[int, int]], tuple[Cluster, ...], PoleChanges]:
    """Places (order number, pole index), clusters and changes of their chosen poles, lowest frequency first."""
    order = np.argsort([cluster.frequency[cluster.chosen] for cluster in clusters], kind="stable").tolist()
    return [clusters[m].place for m in order], tuple(clusters[m] for m in order), changes.of(order)


def _told_by_deviations(
    subspace: Subspace, sweep: Sequence[Poles], chosen_clusters: Sequence[Cluster], others: Sequence[Cluster],
    changes: PoleChanges, notes: list[str],
) -> tuple[tuple[Cluster, ...], tuple[Cluster, ...], PoleChanges]:  # fmt: skip
    """Clusters that are modes by a probability that knows deviations, the other clusters, and changes of the modes.

    The motion is ambient. Modes are, in this order, chosen clusters with a probability of 0.5 or more, or an unknown
    one, and those of `others`, the likeliest first, with 0.8 or more that are no further pole of a mode; of `others`
    only those are judged whose probability without deviations is 0.05 or more. `changes` are those of the chosen
    clusters. A note on chosen clusters left out is appended to `notes`.

    Raises
    ------
    NoModesError
        If none is left.
    """
    scale, n = subspace.data.scale, len(chosen_clusters)
    every = [*chosen_clusters, *(c for c in others if c.probability >= _POSSIBLE)]
    poles, shapes = _scaled_poles(sweep, every, scale)
    every = [cluster for cluster, further in zip(every, _is_further(poles, shapes, n), strict=True) if not further]
    more = changes_of_poles(subspace, changes.spread, sweep, [cluster.place for cluster in every[n:]])
    every, changes = _surest_of_doubtful(subspace, sweep, every, changes.with_changes(*more))
    judged = with_deviations(subspace, sweep, every, changes)
    poles, shapes = _scaled_poles(sweep, judged, scale)
    judged = _with_borrowed_shapes_unknown(judged, poles, shapes)
    taken = [m for m in range(n) if not (np.isfinite(judged[m].excess) and judged[m].probability < _RATHER)]
    for m in sorted(range(n, len(judged)), key=lambda m: -judged[m].probability):
        is_further = _is_further(poles[[*taken, m]], shapes[:, [*taken, m]], len(taken))[-1]
        if judged[m].probability >= LIKELY and not is_further:
            taken.append(m)
    lost = ", ".join(f"{judged[m].frequency[judged[m].chosen]:.4g}" for m in range(n) if m not in taken)
    words = f"stable poles that move with the data as those of noise do are left out: {lost} Hz"
    if not taken:
        raise NoModesError(f"`records` show no mode; {words}. Measure longer, or give `frequencies`")
    if lost:
        notes.append(words)
    not_looked_at = [c for c in others if not any(c.number is cluster.number for cluster in every)]
    rest = (*not_looked_at, *(judged[m] for m in range(len(judged)) if m not in taken))
    return tuple(judged[m] for m in taken), rest, changes.of(taken)


def _surest_of_doubtful(
    subspace: Subspace, sweep: Sequence[Poles], every: Sequence[Cluster], changes: PoleChanges
) -> tuple[list[Cluster], PoleChanges]:
    """Clusters `every` and their `changes`, in the same order, with surer poles for those that are doubtful.

    Doubtful are those whose probability is below 0.5 or NaN; `surest_poles` may choose another pole of them. The others
    stay as they are. `sweep` are the poles of all orders.
    """
    doubtful = [m for m, cluster in enumerate(every) if not cluster.probability >= _RATHER]
    if not doubtful:
        return list(every), changes
    data, clusters = subspace.data, list(every)
    piece = data.seconds / len(subspace.windows)
    doubtful_clusters = [every[m] for m in doubtful]
    surer, moved = surest_poles(
        subspace, sweep, doubtful_clusters, changes.of(doubtful), data.seconds, piece, _POSSIBLE
    )
    poles, shapes = changes.poles.copy(), changes.shapes.copy()
    poles[:, doubtful], shapes[:, :, doubtful] = moved.poles, moved.shapes
    for m, cluster in zip(doubtful, surer, strict=True):
        clusters[m] = cluster
    return clusters, PoleChanges(changes.spread, poles, shapes)


def _least_std(poles: ComplexArray, seconds: float) -> FloatArray:
    """Least standard deviations (Hz), (n_poles,), of the frequencies of `poles` (rad/s) in ambient motion of this length.

    Au (2014), part I: the variance of a frequency f is at least zeta f / (2 pi T) in T seconds. 0 for poles without damping.
    """
    return np.asarray(np.sqrt(np.maximum(-poles.real, 0.0) / seconds) / (2 * np.pi))


def _with_borrowed_shapes_unknown(
    judged: Sequence[Cluster], poles: ComplexArray, shapes: ComplexArray
) -> list[Cluster]:
    """Copies of the clusters `judged`, in order: `shape_error` is at least 1 where the shape may be a neighbour's.

    A pole of noise beside a resonance takes its shape, and with it the small error of that shape. Neighbours are the
    nearest clusters below and above with less `excess`; the shape may be theirs within 20 % of the frequency and with a
    MAC above 0.8. `poles` (n_clusters,), rad/s, and `shapes` (n_channels, n_clusters), scaled, are the chosen ones.
    """
    excess, omega, alike = np.array([cluster.excess for cluster in judged]), np.abs(poles), mac(shapes, shapes)
    copies = []
    for m, cluster in enumerate(judged):
        surer = np.flatnonzero(excess < excess[m])
        surer = surer[np.argsort(np.abs(omega[surer] - omega[m]))]
        below, above = surer[omega[surer] <= omega[m]], surer[omega[surer] > omega[m]]
        borrowed = any(
            alike[m, k] > _ONE_SHAPE and abs(omega[k] - omega[m]) < _NEIGHBOUR * omega[m]
            for k in (*below[:1], *above[:1])
        )
        copies.append(replace(cluster, shape_error=max(cluster.shape_error, 1.0)) if borrowed else cluster)
    return copies


def _is_further(poles: ComplexArray, shapes: ComplexArray, n: int) -> NDArray[np.bool_]:
    """Mask (n_poles,) of poles that repeat one of the first `n`: its shape near its frequency; false for the first.

    `poles` are in rad/s, `shapes` (n_channels, n_poles) scaled. Near is within the bandwidth, the larger of both
    half-power bandwidths, 1 % of the frequency at least; the same shape is a MAC above 0.8.
    """
    if not n:
        return np.zeros(len(poles), dtype=bool)
    width = np.maximum(2 * np.abs(poles.real), _SAME * np.abs(poles))
    gap = np.abs(np.abs(poles)[:, None] - np.abs(poles)[:n])
    alike = (gap <= np.maximum(width[:, None], width[:n])) & (mac(shapes, shapes[:, :n]) > _ONE_SHAPE)
    return np.asarray(alike.any(axis=1) & (np.arange(len(poles)) >= n))


def with_deviations(
    subspace: Subspace, sweep: Sequence[Poles], clusters: Sequence[Cluster], changes: PoleChanges
) -> list[Cluster]:
    """Copies of `clusters` with `excess` and `shape_error` from `changes` of their poles by pieces of the record.

    The excess is the standard deviation of the frequency over the least that the length of the record allows; the error
    is that of the shape over its norm, channels scaled. One channel has no shape: its clusters are returned as they
    are. `sweep` are the poles of all orders.
    """
    data = subspace.data
    if data.n_channels == 1:
        return list(clusters)
    poles, shapes = _scaled_poles(sweep, clusters, data.scale)
    piece, judged = data.seconds / len(subspace.windows), []
    for m, cluster in enumerate(clusters):
        pole, shape = poles[m : m + 1], shapes[:, m : m + 1]
        turned = changes.shapes[:, :, m : m + 1] / data.scale[:, None]
        moved, turned = overlapping_batches(changes.poles[:, m : m + 1], turned, piece, _memory(pole))
        scatter = changes_of_modes(pole, moved, shape, turned)
        least = float(_least_std(pole, data.seconds)[0])
        excess = float(np.linalg.norm(scatter.frequency)) / least if least > 0 else np.inf
        error = np.linalg.norm(scatter.mode_shapes) / np.linalg.norm(unit_largest(shape))
        judged.append(replace(cluster, excess=excess, shape_error=float(error)))
    return judged


def _scaled_poles(
    sweep: Sequence[Poles], clusters: Sequence[Cluster], scale: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Chosen poles of the clusters, (n_clusters,), rad/s, and their shapes over `scale` (n_channels,), (n_channels, n_clusters)."""
    places = [cluster.place for cluster in clusters]
    shapes = np.stack([sweep[k].shapes[:, i] for k, i in places], axis=1)
    return poles_of(sweep, places), np.asarray(shapes / scale[:, None])


def _modal_record(
    subspace: Subspace, sweep: Sequence[Poles], picked: list[tuple[int, int]], motion: FreeDecay,
    changes: PoleChanges | None, notes: list[str],
) -> ModalRecord:  # fmt: skip
    """Modal record of the chosen poles, with shapes scaled to largest entry 1, covariance and warnings.

    `picked` are pairs (order number, pole index). Without `changes` there is no covariance. `notes` become warnings,
    and further ones are appended to this list in place. `subspace` and `sweep` are the decomposition and the poles of
    each order; `motion` says how much is free decay.
    """
    data = subspace.data
    s = poles_of(sweep, picked)
    raw = np.stack([sweep[k].shapes[:, i] for k, i in picked], axis=1)
    order = np.argsort(np.abs(s), kind="stable")
    s, raw = s[order], raw[:, order]
    dofs, merge = displacement_rows(data, s)
    shapes = np.einsum("cdm,dm->cm", merge, raw)
    covariance = std = modal_changes = None
    if changes is not None:
        ds, draw = changes.poles[:, order], changes.shapes[:, :, order]
        widening: FloatArray = np.ones(len(s))
        if not motion.explains_all:
            seconds, n_pieces = data.seconds, len(subspace.windows)
            ds, draw = overlapping_batches(ds, draw, seconds / n_pieces, _memory(s))
            widening = frequency_widening(s, seconds, n_pieces, _memory(s))
        modal_changes = changes_of_modes(s, ds, shapes, np.einsum("cdm,bdm->bcm", merge, draw), widening)
        covariance = frequency_damping_covariance(modal_changes, notes)
        std = shape_deviations(modal_changes)
    notes += _warnings(data, s, len(subspace.windows) if changes is not None and not motion.explains_all else 0)
    return ModalRecord(
        np.abs(s) / (2 * np.pi), -s.real / np.abs(s), unit_largest(shapes), dofs,
        covariance=covariance, shape_std=std, warnings=tuple(notes), changes=modal_changes,
        source=f"{subspace.method}, {len(subspace.left) // data.n_channels} block rows, {data.duration:g} s",
    )  # fmt: skip


def changes_of_modes(
    poles: ComplexArray, pole_changes: ComplexArray, shapes: ComplexArray, shape_changes: ComplexArray,
    widening: FloatArray | float = 1.0,
) -> ModalChanges:  # fmt: skip
    """Changes of frequencies (Hz), damping ratios and shapes with largest entry 1 from those of poles (rad/s) and raw shapes.

    `poles` is (n_modes,), `pole_changes` (n_changes, n_modes), `shapes` (n_channels, n_modes) and `shape_changes`
    (n_changes, n_channels, n_modes); `widening` (n_modes,) are factors on the changes of frequencies.
    """
    largest = np.abs(shapes).argmax(axis=0), np.arange(len(poles))
    top = shape_changes[:, largest[0], largest[1]]
    unit_changes = (shape_changes - unit_largest(shapes) * top[:, None, :]) / shapes[largest]
    moved = np.concatenate([pole_changes.real, pole_changes.imag], axis=1) @ frequency_damping_slope(poles).T
    return ModalChanges(widening * moved[:, : len(poles)], moved[:, len(poles) :], unit_changes)


def shape_deviations(changes: ModalChanges) -> FloatArray:
    """Standard deviations of the real parts of shape entries, (n_channels, n_modes)."""
    return np.sqrt(np.sum(changes.mode_shapes.real**2, axis=0))


def _memory(s: ComplexArray) -> float:
    """1 / (zeta omega) of the slowest mode, s; 0 where none decays."""
    decaying = -s.real[s.real < 0]
    return float(1 / decaying.min()) if len(decaying) else 0.0


def changes_of_poles(
    subspace: Subspace, spread: SingularVectorChanges, sweep: Sequence[Poles], picked: Sequence[tuple[int, int]]
) -> tuple[ComplexArray, ComplexArray]:
    """Changes of poles (rad/s), (n_changes, n_modes), and of shapes, (n_changes, n_channels, n_modes), of chosen modes.

    `spread` are deviations of the subspace matrix through its singular vectors. `picked` are pairs (order number in
    `sweep`, pole index), of models of several orders.
    """
    n_pieces = len(spread.right)
    ds = np.empty((n_pieces, len(picked)), dtype=complex)
    dshape = np.empty((n_pieces, subspace.data.n_channels, len(picked)), dtype=complex)
    for k in {k for k, _ in picked}:
        modes = [m for m, (number, _) in enumerate(picked) if number == k]
        ds[:, modes], dshape[:, :, modes] = pole_deviations(
            subspace, spread, sweep[k].order, [picked[m][1] for m in modes]
        )
    return ds, dshape


def frequency_damping_covariance(changes: ModalChanges, notes: list[str]) -> FloatArray:
    """Covariance (2 n, 2 n) of n frequencies (Hz), then n damping ratios: the sum of x x' over `changes` x.

    With at most 2 n changes, entries between different modes are set to 0, and a note is appended to `notes`.
    """
    change = np.concatenate([changes.frequency, changes.damping_ratio], axis=1)
    n = changes.frequency.shape[1]
    covariance = change.T @ change
    if len(change) <= 2 * n:
        mode = np.tile(np.arange(n), 2)
        covariance = np.where(mode[:, None] == mode, covariance, 0.0)
        notes.append(
            f"{len(change)} pieces cannot tell how {2 * n} numbers vary together: the covariance between modes is "
            f"left out. Raise `n_pieces` above {2 * n}, with a longer record"
        )
    return np.asarray(covariance)


def _warnings(data: ScaledMotion, s: ComplexArray, n_pieces: int) -> list[str]:
    """Warnings on modes with poles `s` (rad/s) that are doubtful, with remedies; [] if none is.

    They are on one channel only, on modes of less than three periods in the longest record of `data`, and, unless
    `n_pieces` is 0, on modes for which an eighth of the records (or a piece, if there are fewer than 8) is shorter than
    two periods or than the memory 1 / (zeta omega). `n_pieces` is the number of pieces behind the covariance, 0 where
    none are used.
    """
    notes, duration, omega = [], data.duration, np.abs(s)
    if data.n_channels == 1:
        notes.append("one channel shows frequencies and damping only, no mode shape; add sensors")
    short = np.flatnonzero(omega * duration < 2 * np.pi * 3)
    if len(short):
        listed = ", ".join(str(i + 1) for i in short)
        notes.append(f"mode {listed} turns less than three times in {duration:g} s; measure longer")
    decay = np.maximum(-s.real, 1e-300)
    if n_pieces:
        batch = data.seconds / min(n_pieces, 8)  # as long as they may grow
        slow = np.flatnonzero((batch * omega < 4 * np.pi) | ((batch * decay < 1) & (duration * decay > 1)))
        if len(slow):
            listed = ", ".join(str(i + 1) for i in slow)
            notes.append(
                f"parts of {batch:.3g} s are short against the memory of mode {listed}: its standard deviation is "
                "uncertain. Measure longer"
            )
    return notes
