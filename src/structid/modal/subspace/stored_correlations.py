"""Modes of stored correlation functions by covariance-driven stochastic subspace identification.

The functions R(k) = C A^k G of channels with references fill the block Hankel matrix as they stand: its columns are those of
the references alone (reference-based identification).

Where the references are all channels and the number of averages is known, the errors of the functions follow from the
functions themselves: those of N samples scatter with covariances of sum_u [R_ip(u) R_jq(u + l - k) + R_iq(u + l) R_jp(u - k)]
/ N (Bartlett). They are drawn as errors of spectra, whose lines are independent, and sent through the identification to first
order.

References
----------
Bartlett (1946), On the theoretical specification and sampling properties of autocorrelated time series, J. R. Stat. Soc.
Suppl. 8, 27-41; Brillinger (2001), Time Series: Data Analysis and Theory, sections 7.3 and 7.6.
Peeters and De Roeck (1999), Reference-based stochastic subspace identification for output-only modal analysis, Mech. Syst.
Signal Process. 13, 855-878.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.errors import InputError, NoModesError
from structid.modal.correlations import ScaledMotion, displacement_rows, hankel
from structid.modal.method import ModalIdentification, ModalOptions, by_rising_frequency
from structid.modal.modal_record import ModalRecord, unit_largest
from structid.modal.poles.poles import modal_phase_collinearity
from structid.modal.subspace.kernel import Subspace, poles_of_orders, shift_invariant
from structid.modal.subspace.pole_uncertainty import SingularVectorChanges
from structid.modal.subspace.subspace_modes import (
    BLOCK_ROWS,
    MAX_ORDER,
    ONE_PHASE,
    PoleChanges,
    by_frequency,
    changes_of_modes,
    changes_of_poles,
    frequency_damping_covariance,
    left_out_clusters,
    numbers_of,
    picked_poles,
    poles_of,
    shape_deviations,
    surest_poles,
)
from structid.records.stored_averages import CorrelationRecord
from structid.similarity import mac

#: Rows of the block Hankel matrix at most, where a low mode asks for many lags.
_LARGEST = 600
#: Part of the power that lies below the lowest motion that the lags are made for.
_LOW_PART = 0.02
#: MAC from which on two poles near each other have one shape.
_SAME_SHAPE = 0.9
#: Draws of errors for a covariance, which is known to about 7 % with them.
_DRAWS = 100
_BIASED = "functions weighted by 1 - lag / length of the record (biased ones) show too much damping"
_NO_REFERENCES = (
    "no standard deviations: they need correlation functions of all channels with all channels, or the time histories"
)
_NO_AVERAGES = (
    "no standard deviations: they need the number of averages (`averages`), that is, the length of the record over that of the"
    " lags"
)


def correlation_outputs(record: CorrelationRecord) -> ScaledMotion:
    """`ScaledMotion` without samples for the channels of a correlation record, scaled by the root mean square of their functions.

    The scale of a channel is that of its largest function, (n_channels,).

    Raises
    ------
    InputError
        If all functions of a channel are 0.
    """
    power = np.sqrt((record.values**2).mean(axis=0))
    size = power.max(axis=1)
    if not (size > 0).all():
        dead = record.channels[int(np.argmin(size))]
        raise InputError(
            f"the correlation functions of channel {dead} are 0; leave this channel out, or repair the sensor"
        )
    return ScaledMotion((), size, record.channels, record.quantities, record.sampling_rate)


def correlation_modes(record: CorrelationRecord, options: ModalOptions) -> ModalIdentification:
    """Modes of stored correlation functions: frequencies, damping ratios and shapes.

    They have a covariance where the references are all channels and the record says its `averages`, each taken to be as long
    as the lags; averages over longer blocks leave smaller errors than stated.

    Parameters
    ----------
    record : CorrelationRecord
    options : ModalOptions
        Used are `orders`, `block_rows`, `criteria` and `frequencies`.

    Raises
    ------
    InputError
        If there are too few lags for the orders asked for, or a channel is dead.
    NoModesError
        If no pole is stable.
    """
    data = correlation_outputs(record)
    n_channels, n_references = record.values.shape[1:]
    rows, columns = _shape(record, data.scale, options.block_rows)
    places = [record.channels.index(dof) for dof in record.references]
    stack = record.values[1 : rows + columns] / (data.scale[:, None] * data.scale[places])
    room = min((rows - 1) * n_channels, columns * n_references)
    orders = list(options.orders) if options.orders is not None else list(range(2, min(MAX_ORDER, room) + 1, 2))
    if not orders or min(orders) < 1 or max(orders) > room:
        raise InputError(
            f"`orders` must lie from 1 to {room} for {n_channels} channels, {n_references} references and"
            f" {len(record.values)} lags, got {orders}; export more lags"
        )
    method = "covariance-driven SSI of stored correlation functions"
    averages = record.averages if set(record.references) == set(record.channels) else None
    subspace = shift_invariant(hankel(stack, rows, columns), data, method, max(orders), complete=averages is not None)
    sweep = poles_of_orders(subspace, [order for order in sorted(set(orders)) if order <= subspace.max_order])
    options = ModalOptions(
        options.orders, options.block_rows, options.criteria.damped, options.frequencies, refine=False
    )
    selection = picked_poles(sweep, data.scale, options)
    if not selection.places:
        raise NoModesError(
            "`records` show no mode that is stable over `orders` and meets `criteria`; widen the criteria, or export more lags"
        )
    order = sorted(
        range(len(selection.places)), key=lambda n: sweep[selection.places[n][0]].omega[selection.places[n][1]]
    )
    picked = [selection.places[n] for n in order]
    clusters = tuple(selection.clusters[n] for n in order) if selection.clusters else ()
    errors = None
    if averages is not None:
        largest = max(sweep[k].order for k in [k for k, _ in picked] + numbers_of(clusters))
        drawn = error_deviations(record, averages, subspace, rows, columns, largest)
        errors = PoleChanges(drawn, *changes_of_poles(subspace, drawn, sweep, picked))
        if clusters and options.frequencies is None:
            seconds = averages * len(record.values) / record.sampling_rate
            picked, clusters, errors = by_frequency(*surest_poles(subspace, sweep, clusters, errors, seconds))
    poles = poles_of(sweep, picked)
    shapes = np.stack([sweep[k].shapes[:, i] for k, i in picked], axis=1)
    dofs, merge = displacement_rows(data, poles)
    merged = np.einsum("cdm,dm->cm", merge, shapes)
    notes = [*selection.notes, _BIASED]
    if n_channels == 1:
        notes.append("one channel shows frequencies and damping only, no mode shape; add sensors")
    frequency, ratio = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
    source = f"{method}, {rows} block rows, lags to {(rows + columns - 1) / record.sampling_rate:.4g} s"
    changes = covariance = None
    if errors is not None:
        changes = changes_of_modes(poles, errors.poles, merged, np.einsum("cdm,bdm->bcm", merge, errors.shapes))
        covariance = frequency_damping_covariance(changes, notes)
    else:
        notes.append(_NO_REFERENCES if record.averages is not None else _NO_AVERAGES)
    modes = ModalRecord(
        frequency, ratio, unit_largest(merged), dofs, covariance, None if changes is None else shape_deviations(changes),
        tuple(notes), source, changes=changes,
    )  # fmt: skip
    if not clusters or options.frequencies is not None:
        return ModalIdentification(modes, "ssi_cov", sweep, clusters, options)
    left_out = by_rising_frequency(left_out_clusters(selection.others, frequency, ratio))
    result = ModalIdentification(modes, "ssi_cov", sweep, clusters, options, left_out)
    is_split = _is_split_pole(poles, shapes / data.scale[:, None], result.probability)
    result = result.kept(
        ~is_split, "stable poles with the shape and, to within its bandwidth, the frequency of a surer one"
    )
    if n_channels == 1:
        return result
    collinearity = modal_phase_collinearity(result.modes.mode_shapes.astype(complex))
    return result.kept(
        collinearity >= ONE_PHASE,
        "stable poles without a shape in one phase, as at the edge of a filter or of the forces",
    )


def error_deviations(
    record: CorrelationRecord, averages: int, subspace: Subspace, rows: int, columns: int, max_order: int
) -> SingularVectorChanges:
    """Deviations of the block Hankel matrix by 100 drawn errors of correlation functions between all channels.

    Deviations are over the square root of 100, so that sums of their products are covariances. `record` has the
    functions, `averages` is the number of averages behind each; `rows` and `columns` are numbers of blocks of the
    matrix, and `max_order` is the number of leading singular vectors by which deviations are multiplied. `subspace` has
    the decomposition of the matrix.
    """
    order = [record.references.index(dof) for dof in record.channels]
    scale = subspace.data.scale
    functions = record.values[:, :, order] / (scale[:, None] * scale)
    u, v = subspace.left[:, :max_order], subspace.right[:, :max_order]
    stacks = (
        error[1 : rows + columns][:, :, np.argsort(order)] / np.sqrt(_DRAWS)
        for error in drawn_errors(functions, averages, _DRAWS)
    )
    changes = (hankel(stack, rows, columns) for stack in stacks)
    return SingularVectorChanges.seen(subspace, ((change @ v, change.T @ u) for change in changes))


def drawn_errors(functions: FloatArray, averages: float, n_draws: int) -> Iterator[FloatArray]:
    """Random errors (n_lags, n_channels, n_channels) of correlation functions, `n_draws` in number.

    `functions` (n_lags, n_channels, n_channels) are the mean of `averages` blocks as long as the lags. The spectral matrix S
    of a line has the error B Z B' / sqrt(averages / 2) with S = B B' and Z Hermitian, with independent entries of variance 1;
    lines are those of twice the lags. A taper on the later half of the lags limits leakage of strong modes.
    """
    n = len(functions)
    taper = np.cos(0.5 * np.pi * np.maximum(2 * np.arange(n) / n - 1, 0.0)) ** 2
    tapered = taper[:, None, None] * functions
    both = np.concatenate([tapered, np.zeros_like(tapered[:1]), tapered[:0:-1].transpose(0, 2, 1)])
    lines = np.fft.rfft(both, axis=0)
    power, vectors = np.linalg.eigh(0.5 * (lines + lines.conj().transpose(0, 2, 1)))
    root = vectors * np.sqrt(np.maximum(power, 0.0) / np.sqrt(averages / 2))[:, None, :]
    rng = np.random.default_rng(0)
    for _ in range(n_draws):
        real, imaginary = rng.standard_normal((2, *lines.shape)) / 2
        hermitian = real + real.transpose(0, 2, 1) + 1j * (imaginary - imaginary.transpose(0, 2, 1))
        yield np.fft.irfft(root @ hermitian @ root.conj().transpose(0, 2, 1), 2 * n, axis=0)[:n]


def _is_split_pole(poles: ComplexArray, shapes: ComplexArray, probability: FloatArray) -> NDArray[np.bool_]:
    """Mask (n_modes,) of poles near a more probable pole of the same shape, as when noise splits a mode in two.

    Near is within the half-power bandwidth of either, the same shape a MAC above 0.9; a split pole splits off no other.
    `poles` (n_modes,) are in rad/s, `shapes` (n_channels, n_modes) scaled, `probability` (n_modes,) is that of being a
    mode (NaN counts as 0).
    """
    likeness = mac(shapes, shapes)
    width = 2 * np.abs(poles.real)
    is_split = np.zeros(len(poles), dtype=bool)
    for n in np.argsort(-np.nan_to_num(probability), kind="stable"):
        near = np.abs(poles.imag - poles[n].imag) <= np.maximum(width, width[n])
        surer = np.nan_to_num(probability) > np.nan_to_num(probability[n])
        is_split[n] = np.any(near & surer & ~is_split & (likeness[n] > _SAME_SHAPE))
    return is_split


def _shape(record: CorrelationRecord, scale: FloatArray, block_rows: int | None) -> tuple[int, int]:
    """Numbers of block rows and block columns of the Hankel matrix of stored correlation functions.

    Rows plus columns are at most the number of lags. By default rows and columns have room for all model orders, and
    the rows cover a period of the lowest motion (2 % of the power is below it), as far as there are lags. `scale`
    (n_channels,) is the size of each channel, `block_rows` the number of rows asked for or None. `InputError` if the
    lags do not suffice.
    """
    n_lags, n_channels, n_references = record.values.shape
    lines = np.abs(np.fft.rfft(record.values / scale[:, None], 2 * n_lags, axis=0)).sum(axis=(1, 2))
    power = np.cumsum(lines[1:])
    first = 1 + int(np.searchsorted(power, _LOW_PART * power[-1]))
    period = min(-(-2 * n_lags // first), max(_LARGEST // n_channels, BLOCK_ROWS))
    usual = [max(BLOCK_ROWS, -(-2 * MAX_ORDER // number)) for number in (n_channels, n_references)]
    rows = block_rows if block_rows is not None else min(max(usual[0], period), n_lags // 2)
    columns = min(max(usual[1], rows), n_lags - rows)
    if rows < 2 or columns < 1:
        raise InputError(f"`block_rows` must be at least 2 and less than the {n_lags} lags, got {rows}; lower it")
    return rows, columns
