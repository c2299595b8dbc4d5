"""A case as a user would have it: a folder with study.toml and record files, and beside them truth.json."""

from __future__ import annotations

import copy
import json
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from wrong_models.assembly import PLAIN, Table, sets
from wrong_models.faults import Fault, Readings, accepted, changed, other_state
from wrong_models.measuring import (
    FORCE_NOISE,
    FREQUENCY_ERROR,
    PERIOD,
    RELATIVE,
    SHAPE_ERROR,
    VISCOUS,
    floor_of,
    measured,
)
from wrong_models.record_files import QUANTITY, frf_file, history_file, modes_file, toml
from wrong_models.rigs import RIGS, Rig, exported, started, viscous

#: How far off the parameters of the study begin.
STARTS = {"near": (0.03, 0.10), "far": (0.15, 0.30)}
#: The words after `structid` that find the modes of an ambient record, where a study needs them first.
MODES_COMMAND = "modes_command.json"


@dataclass(frozen=True)
class Case:
    """One study: rig, test, faults (none for a twin) and start.

    Attributes
    ----------
    harmless : bool
        The faults are too small to matter: the right answer is that of a sound model.
    aliases : tuple of (kind, place)
        Other causes that the data cannot tell from the fault; found by `telling_apart`.
    """

    name: str
    rig: str
    record: str
    faults: tuple[Fault, ...] = ()
    start: str = "near"
    harmless: bool = False
    aliases: tuple[tuple[str, str], ...] = ()

    @property
    def seed(self) -> int:
        return zlib.crc32(self.name.encode())

    @property
    def is_twin(self) -> bool:
        return not self.faults or self.harmless

    def measured_rig(self) -> Rig:
        """The rig with the damping of its test; masses are known where only modes are measured."""
        rig = RIGS[self.rig]()
        if self.record in VISCOUS:
            rig = viscous(rig, 2.0)
        if self.record in ("modal", "modalstates", "ambient"):
            damped = ("mass", "loss_factor", "mass_damping", "stiffness_damping", "viscous_damping")
            rig = replace(rig, unknowns=tuple(one for one in rig.unknowns if one.property not in damped))
        return rig


def written(case: Case, folder: Path) -> dict[str, Any]:
    """Write the study of `case` into `folder`, and return what truth.json holds."""
    folder.mkdir(parents=True, exist_ok=True)
    rng, rig = np.random.default_rng(case.seed), case.measured_rig()
    table, truth = started(rig, rng, STARTS[case.start])
    true = changed(rig, case.faults)
    records = []
    for number, (name, extra) in enumerate(_setups(case, rig)):
        own = copy.deepcopy(true)
        for node, kg in extra:
            own.setdefault("point_mass", []).append({"name": "known", "nodes": [node], "mass": kg})
        own_faults = [fault for fault in case.faults if fault.kind != "record"]
        for fault in case.faults:
            own = other_state(own, fault) if fault.kind == "record" and fault.where == name else own
        made = measured(rig, own, case.record, own_faults, rng)
        section = _record(case, rig, made, folder, number)
        if name:
            section = {"name": name, **section}
        if extra:
            section["structure"] = {"point_mass": [{"name": "known mass", "nodes": n, "mass": kg} for n, kg in extra]}
        records.append(section)
    study: dict[str, Any] = {
        "title": case.rig.replace("_", " "),
        "structure": _structure(rig, table, folder),
        "unknown": [_unknown(one) for one in rig.unknowns],
        "record": records if len(records) > 1 else records[0],
    }
    if case.record in ("time", "h1", "quake"):
        study["method"] = {"band": list(rig.band)}
    (folder / "study.toml").write_text(toml(study), encoding="utf-8")
    if any(fault.kind == "damping_law" for fault in case.faults):
        truth = {name: None if name.startswith("loss_factor") else value for name, value in truth.items()}
    told = _told(case, rig, truth)
    (folder / "truth.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    return told


def _told(case: Case, rig: Rig, truth: dict[str, float | None]) -> dict[str, Any]:
    """What truth.json holds: the parameters under structid's names, and each fault with the causes that name it."""
    more = [{"kind": kind, "where": place.split()} for kind, place in case.aliases]
    faults = [
        {"kind": f.kind, "where": f.where, "size": f.size, "accepted": accepted(f, rig.table) + more}
        for f in case.faults
    ]
    return {
        "name": case.name, "rig": case.rig, "record": case.record, "start": case.start, "parameters": truth,
        "harmless": case.harmless, "faults": faults,
    }  # fmt: skip


def _setups(case: Case, rig: Rig) -> list[tuple[str, tuple[tuple[int, float], ...]]]:
    """Names of set-ups and the known masses that each has in addition."""
    if not case.record.endswith("states"):
        return [("", ())]
    (first, light), (second, heavy) = rig.known
    return [("bare", ()), (f"mass_on_{first}", ((first, light),)), (f"mass_on_{second}", ((second, heavy),))]


def _unknown(one: Any) -> dict[str, Any]:
    elements = one.elements if len(one.elements) > 1 else one.elements[0]
    found = {"property": one.property, "elements": list(elements) if isinstance(elements, tuple) else elements}
    return found | ({"each": True} if one.each else {}) | ({"factor": True} if one.factor else {})


def _structure(rig: Rig, table: Table, folder: Path) -> dict[str, Any]:
    """`[structure]`, with the matrices of each element set in files where the rig is exported."""
    head = {key: table[key] for key in ("active", "fixed") if table[key]}
    if "base" in table:
        head["base"] = [{"name": "table", "supports": table["base"]}]
    nodes = {str(node): at for node, at in table["nodes"].items()}
    if not rig.exported:
        head["subdivide"] = 1  # the simulated structure consists of the drawn elements
        return {**head, "nodes": nodes, **{kind: own for kind, own in table.items() if kind not in PLAIN}}
    groups, files = [], exported(table, tuple(own["name"] for _, own in sets(table)))
    every = list(dict.fromkeys(dof for dofs, *_ in files.values() for dof in dofs))
    (folder / "dofs.txt").write_text("\n".join(every) + "\n", encoding="utf-8")
    for name, (dofs, *matrices) in files.items():
        at, entry = [every.index(dof) for dof in dofs], {"name": name}
        for key, matrix in zip(("mass", "stiffness"), matrices, strict=True):
            whole = np.zeros((len(every), len(every)))
            whole[np.ix_(at, at)] = matrix
            entry[key] = f"{name}_{key}.npz"
            sparse.save_npz(folder / entry[key], sparse.csc_matrix(whole))
        own = next(own for _, own in sets(table) if own["name"] == name)
        groups.append({**entry, "loss_factor": own["loss_factor"]})
    return {**head, "nodes": nodes, "matrices": {"dofs": "dofs.txt"}, "matrix_group": groups}


def _record(case: Case, rig: Rig, made: Readings, folder: Path, number: int) -> dict[str, Any]:
    """The record's file, in a format that goes by the seed, and the `[record]` that reads it."""
    stated = float(np.prod([fault.amount for fault in case.faults if fault.kind == "noise_level"]))
    if case.record == "ambient":
        section = history_file(folder / "ambient.npz", made, "acceleration")
        (folder / MODES_COMMAND).write_text(json.dumps(_modes_command(section)), encoding="utf-8")
        return {"path": "modes/modes.json", "modes": {}}
    if made.std is not None:
        path = folder / f"modes{number or ''}{('.uff', '.csv')[case.seed % 2]}"
        return modes_file(path, made, FREQUENCY_ERROR * stated, SHAPE_ERROR * stated)
    formats = (".npz", ".mat") if made.coherence is not None else (".npz", ".uff", ".csv", ".mat")
    path = folder / f"record{number or ''}{formats[case.seed % len(formats)]}"
    if made.force is None:
        section = frf_file(path, made, "transmissibility" if case.record == "shaken" else rig.kind)
        if made.coherence is None:
            section["noise"] = {"relative": RELATIVE * stated, "absolute": floor_of(made.motion) * stated}
        return section
    drive = "acceleration" if case.record == "quake" else "force"
    section = history_file(path, made, QUANTITY[rig.kind], drive)
    if case.record in ("time", "quake"):
        sigma = [FORCE_NOISE * made.force[:, 0].std(), *(RELATIVE * made.motion.std(axis=0))]
        return section | {"time": {"noise": [float(f"{stated * one:.4g}") for one in sigma]}}
    segment = {"estimator": "H1", "segment_length": PERIOD, "window": "boxcar", "overlap": 0.0, "detrend": "none"}
    for fault in case.faults:
        if fault.kind == "window":
            segment = {"estimator": "H1", "segment_length": int(fault.amount)}
    return section | {"frf": segment}


def _modes_command(section: dict[str, Any]) -> list[str]:
    """What a user types to find the modes of the ambient record."""
    return [
        "modes", section["path"], "--sampling-rate", str(section["sampling_rate"]), "--channels",
        ",".join(section["channels"]), "--quantity", "acceleration", "--array", "samples", "--out", "modes", "--no-report",
    ]  # fmt: skip
