"""Modes of several set-ups with common references from one subspace identification (PreGER).

With the references' past as the only columns, the block Hankel matrix of set-up j is H_j = O_j C_j: the observability
matrix of its sensors times a part C_j that holds its own excitation. The references' rows of all set-ups side by side
have one column space, [H_1 ... H_N]_ref = O_ref [C_1 ... C_N]; its right singular vectors give all C_j in one basis,
and O_j = H_j C_j^+ the other sensors in the same basis. A common level of excitation of a set-up drops out of it.

References
----------
Doehler and Mevel (2012), Modular subspace-based system identification from multi-setup measurements, IEEE Trans.
Autom. Control 57(11), 2951-2956; Mevel, Basseville, Benveniste and Goursat (2002), Merging sensor data from multiple
measurement set-ups for non-stationary subspace-based modal analysis, J. Sound Vib. 249(4), 719-741.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structid.arrays import ComplexArray
from structid.dof import Dof
from structid.errors import InputError, NoModesError
from structid.modal.merging.joint_subspace import JointSubspace, joint_deviations, joint_poles, joint_subspace
from structid.modal.merging.merging import common_sensors
from structid.modal.merging.setup_data import SetupData, setup_data
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalChanges, ModalRecord
from structid.modal.poles import Poles
from structid.modal.subspace.close_modes import close_mode_notes
from structid.modal.subspace.modes import frequency_damping_changes, frequency_damping_covariance, picked_poles
from structid.records import TimeRecord

_MAX_ORDER = 60
_BLOCK_ROWS = 30


def joint_modes(
    setups: Sequence[TimeRecord],
    references: Sequence[Dof | str] | None = None,
    options: ModalOptions | None = None,
) -> ModalIdentification:
    """Modes of ambient motion that several set-ups measured one after another, identified together.

    Parameters
    ----------
    setups : sequence of TimeRecord
        Two or more, of stationary motion, with one kind of quantity and one sampling rate; forces are left out. The
        structure is taken to be the same in all of them: compare `merged_setups`, which tests that.
    references : sequence of Dof, optional
        Sensors that all set-ups have, where every mode should move; by default all such.
    options : ModalOptions, optional
        `orders`, `block_rows`, `criteria`, `frequencies` and `n_pieces` (of each set-up) count.

    Returns
    -------
    ModalIdentification
        Shapes at all sensors, counted positive along their axes; covariance and deviations of first order from the
        spread over pieces of all set-ups.

    Raises
    ------
    InputError
        If set-ups do not fit together, or records are too short.
    NoModesError
        If there is no stable mode.

    Notes
    -----
    Cost: the covariances with the references only, one singular value decomposition of the references' rows side by
    side, and some products for every piece.
    """
    chosen = options or ModalOptions()
    if len(setups) < 2:
        raise InputError(f"`setups` must hold two set-ups or more, got {len(setups)}; use `identify_modes` for one")
    data = setup_data(setups, common_sensors([_moving(setup) for setup in setups], references))
    rows = _block_rows(data, chosen.block_rows)
    orders = _orders(data, rows, chosen.orders)
    space = joint_subspace(data, rows, max(chosen.n_pieces, 1))
    sweep = tuple(joint_poles(space, order) for order in orders)
    picked, found, notes = picked_poles(sweep, data.scale, chosen)
    if not picked:
        raise NoModesError(
            "`setups` show no mode that is stable over `orders` and meets `criteria`; widen the criteria, raise"
            " `block_rows` or the greatest order, or measure longer"
        )
    modes = _modal_record(space, sweep, picked, [*data.notes, *notes])
    more = close_mode_notes(modes, data.duration, len(setups))
    return ModalIdentification(replace(modes, warnings=(*modes.warnings, *more)), "joint_setups", sweep, found, chosen)


def _moving(record: TimeRecord) -> list[Dof]:
    pairs = zip(record.channels, record.quantities, strict=True)
    return [dof for dof, quantity in pairs if quantity != "force"]


def _block_rows(data: SetupData, given: int | None) -> int:
    if given is not None:
        if given < 2:
            raise InputError(f"`block_rows` must be at least 2, got {given}; a shift needs two samples")
        return given
    shortest = min(len(y) for y in data.series)
    few = -(-2 * _MAX_ORDER // data.n_references)
    rows = min(max(_BLOCK_ROWS, few), shortest // 8)
    if rows < 2:
        raise InputError(f"every set-up must hold at least 16 samples, got {shortest}; measure longer")
    return rows


def _orders(data: SetupData, rows: int, given: Sequence[int] | None) -> list[int]:
    room = (rows - 1) * data.n_references
    orders = list(range(2, min(_MAX_ORDER, room) + 1, 2)) if given is None else sorted({int(n) for n in given})
    if not orders or orders[0] < 1 or orders[-1] > room:
        raise InputError(
            f"`orders` must lie from 1 to {room} for {data.n_references} references and {rows} block rows, got"
            f" {orders[:4]}; raise `block_rows`, or add references"
        )
    return orders


def _modal_record(
    space: JointSubspace, sweep: Sequence[Poles], picked: list[tuple[int, int]], notes: list[str]
) -> ModalRecord:
    picked = sorted(picked, key=lambda p: abs(sweep[p[0]].poles[p[1]]))
    s = np.array([sweep[k].poles[i] for k, i in picked])
    shapes = np.stack([sweep[k].shapes[:, i] for k, i in picked], axis=1)
    largest = np.abs(shapes).argmax(axis=0), np.arange(len(s))
    unit = shapes / shapes[largest]
    covariance = std = changes = None
    if all(len(windows) > 1 for windows in space.windows):
        ds, dshape = _all_deviations(space, sweep, picked)
        dunit = (dshape - unit * dshape[:, largest[0], largest[1]][:, None, :]) / shapes[largest]
        dunit[:, largest[0], largest[1]] = 0.0
        changes = ModalChanges(*frequency_damping_changes(s, ds), dunit)
        covariance = frequency_damping_covariance(changes, notes)
        std = np.sqrt(np.sum(dunit.real**2, axis=0))
        notes += _piece_notes(space, s)
    data = space.data
    source = f"{len(data.series)} set-ups identified together, {space.rows} block rows, {data.duration:g} s the longest"
    return ModalRecord(
        np.abs(s) / (2 * np.pi), -s.real / np.abs(s), unit, data.channels, covariance, std, tuple(notes), source,
        changes=changes,
    )  # fmt: skip


def _piece_notes(space: JointSubspace, s: ComplexArray) -> list[str]:
    """Modes whose memory is long against the pieces that the covariance comes from."""
    shortest = min(len(y) / len(own) for y, own in zip(space.data.series, space.windows, strict=True))
    piece = shortest / space.data.sampling_rate
    slow = np.flatnonzero((piece * -s.real < 1) | (piece * np.abs(s) < 4 * np.pi))
    if not slow.size:
        return []
    return [
        f"pieces of {piece:.3g} s are short against the memory of mode {', '.join(str(i + 1) for i in slow)}: its"
        " standard deviation is uncertain. Lower `n_pieces`, or measure longer"
    ]


def _all_deviations(
    space: JointSubspace, sweep: Sequence[Poles], picked: Sequence[tuple[int, int]]
) -> tuple[ComplexArray, ComplexArray]:
    """`joint_deviations` of modes that come from several orders."""
    n_pieces = sum(map(len, space.windows))
    ds = np.empty((n_pieces, len(picked)), dtype=complex)
    dshape = np.empty((n_pieces, len(space.data.channels), len(picked)), dtype=complex)
    for k in sorted({k for k, _ in picked}):
        modes = [m for m, (number, _) in enumerate(picked) if number == k]
        ds[:, modes], dshape[:, :, modes] = joint_deviations(space, sweep[k].order, [picked[m][1] for m in modes])
    return ds, dshape
