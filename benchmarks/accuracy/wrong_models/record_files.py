"""Record files as measuring software writes them (NPZ, MAT, CSV, universal files), and TOML.

Each writer returns the keys of `[record]` that read its file.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: universal file formats, datasets 55, 58 and 164.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io

from wrong_models.assembly import split
from wrong_models.faults import Readings

QUANTITY = {
    "receptance": "displacement", "mobility": "velocity", "accelerance": "acceleration", "transmissibility": "acceleration",
}  # fmt: skip
UNIT = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N"}
#: Codes of universal files.
_ORDINATE, _AXIS = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}, "XYZ"


def frf_file(path: Path, made: Readings, kind: str) -> dict[str, Any]:
    """FRFs: NPZ and MAT hold bare arrays, and coherence where there is one."""
    section: dict[str, Any] = {"path": path.name}
    if path.suffix in (".npz", ".mat"):
        arrays = {"frf": made.motion, "f": made.axis}
        section |= {"array": "frf", "frequency_array": "f", "kind": kind, "outputs": made.sensors, "inputs": made.loads}
        if made.coherence is not None:
            arrays["coherence"] = made.coherence
            section |= {"coherence_array": "coherence", "averages": made.averages}
        _arrays(path, arrays)
        return section
    motion = QUANTITY[kind]
    pairs = [(o, i, made.motion[:, k, j]) for k, o in enumerate(made.sensors) for j, i in enumerate(made.loads)]
    if path.suffix == ".csv":
        below = f"({UNIT[motion]})" if kind == "transmissibility" else "N"
        header = [f"{o}/{i} [({UNIT[motion]})/{below}] {part}" for o, i, _ in pairs for part in ("re", "im")]
        _csv(path, ["frequency_hz", *header], [made.axis, *(part for _, _, h in pairs for part in (h.real, h.imag))])
    else:
        reference = motion if kind == "transmissibility" else "force"
        _universal(path, [_function(made.axis, h, o, motion, i, reference) for o, i, h in pairs])
    return section


def history_file(path: Path, made: Readings, quantity: str, drive: str = "force") -> dict[str, Any]:
    """What drives, and motion."""
    channels = [*made.loads, *made.sensors]
    quantities = [drive] * len(made.loads) + [quantity] * len(made.sensors)
    values = np.hstack([made.force, made.motion])
    section: dict[str, Any] = {"path": path.name}
    if path.suffix in (".npz", ".mat"):
        _arrays(path, {"samples": values})
        rate = float(f"{1 / (made.axis[1] - made.axis[0]):.12g}")
        return section | {"array": "samples", "sampling_rate": rate, "channels": channels, "quantities": quantities}
    if path.suffix == ".csv":
        header = [f"{c} [{UNIT[q]}]" for c, q in zip(channels, quantities, strict=True)]
        _csv(path, ["time_s", *header], [made.axis, *values.T])
    else:
        named = zip(channels, quantities, values.T, strict=True)
        _universal(path, [_function(made.axis, own, c, q) for c, q, own in named])
    return section


def modes_file(path: Path, made: Readings, frequency_error: float, shape_error: float) -> dict[str, Any]:
    """Modes as CSV with their standard deviations, or as a universal file that leaves those to the study."""
    assert made.damping is not None
    if path.suffix == ".csv":
        header, columns = ["frequency_hz", "frequency_std_hz"], [made.axis, frequency_error * made.axis]
        for j, dof in enumerate(made.sensors):
            header += [dof, f"{dof} std"]
            columns += [made.motion[:, j], np.full(len(made.axis), shape_error)]
        _csv(path, [*header, "damping_ratio"], [*columns, made.damping])
        return {"path": path.name, "modes": {}}
    nodes = sorted({split(dof)[0] for dof in made.sensors})
    blocks = []
    for k, (frequency, ratio) in enumerate(zip(made.axis, made.damping, strict=True)):
        shape = {node: [0.0, 0.0, 0.0] for node in nodes}
        for j, dof in enumerate(made.sensors):
            node, direction = split(dof)
            shape[node][_AXIS.index(direction)] = made.motion[k, j]
        lines = ["modal test", *["NONE"] * 4, _integers(1, 2, 2, 8, 2, 3), _integers(2, 4, 1, k + 1)]
        lines.append(_reals(frequency, 0.0, ratio, 0.0))
        blocks.append((55, lines + [text for node in nodes for text in (_integers(node), _reals(*shape[node]))]))
    _universal(path, blocks)
    return {"path": path.name, "modes": {"frequency_error": frequency_error, "shape_error": shape_error}}


def _arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    if path.suffix == ".npz":
        np.savez(path, **arrays)  # type: ignore[arg-type]
    else:
        io.savemat(path, arrays)


def _csv(path: Path, header: Sequence[str], columns: Sequence[np.ndarray]) -> None:
    rows = (",".join(repr(float(x)) for x in line) for line in np.column_stack(columns))
    path.write_text("\n".join([",".join(header), *rows]) + "\n", encoding="utf-8")


def _integers(*values: int) -> str:
    return "".join(f"{value:10d}" for value in values)


def _reals(*values: float) -> str:
    return "".join(f"{value:13.5E}" for value in values)


def _universal(path: Path, blocks: Sequence[tuple[int, list[str]]]) -> None:
    """A universal file in SI units."""
    units = (164, [f"{1:10d}{'SI':<20s}{1:10d}", "".join(f"{x:25.17E}" for x in (1, 1, 1)), f"{273.15:25.17E}"])
    lines = [line for number, own in (units, *blocks) for line in ("    -1", f"{number:6d}", *own, "    -1")]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _function(
    axis: np.ndarray, values: np.ndarray, dof: str, quantity: str, load: str | None = None, reference: str = "force"
) -> tuple[int, list[str]]:
    """Dataset 58 of an FRF (with its load) or a history, its abscissa even."""
    places = []
    for own in (dof, load):
        node, direction = split(own) if own else (0, "")
        places.append(f" {'NONE':<10s}{node:10d}{_AXIS.index(direction) + 1 if own else 0:4d}")
    sides = [18 if load else 17, _ORDINATE[quantity], _ORDINATE[reference] if load else 0, 0]
    numbers = np.stack([values.real, values.imag], axis=1).ravel() if load else values
    return 58, [
        f"{dof} {quantity}", *["NONE"] * 4,
        f"{4 if load else 1:5d}{0:10d}{0:5d}{0:10d}{places[0]}{places[1]}",
        _integers(6 if load else 4, len(axis), 1) + _reals(axis[0], axis[1] - axis[0], 0.0),
        *(f"{side:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {'NONE':<20s}" for side in sides),
        *("".join(f"{x:20.12E}" for x in numbers[at : at + 4]) for at in range(0, len(numbers), 4)),
    ]  # fmt: skip


def toml(table: dict[str, Any], place: str = "") -> str:
    """TOML of nested dictionaries; a list of dictionaries is an array of tables."""

    def is_tables(value: Any) -> bool:
        return isinstance(value, list) and bool(value) and all(isinstance(one, dict) for one in value)

    lines = [f"{_key(k)} = {_value(v)}" for k, v in table.items() if not isinstance(v, dict) and not is_tables(v)]
    text = "\n".join(lines) + "\n" if lines else ""
    for key, value in table.items():
        inner = f"{place}.{key}" if place else key
        if isinstance(value, dict):
            text += f"\n[{inner}]\n{toml(value, inner)}"
        elif is_tables(value):
            text += "".join(f"\n[[{inner}]]\n{toml(one, inner)}" for one in value)
    return text


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    return json.dumps(value)
