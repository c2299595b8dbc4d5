"""The IASC-ASCE benchmark as a user meets it: study files, `structid modes` and `structid identify`, and no knowledge of the truth.

    python benchmarks/accuracy/iasc_asce_studies.py FOLDER OUT [--rows forced ambient condensed storeys] [--cases 1] [--write]

Writes studies of the undamaged and the damaged states to OUT (with `--write` that is all) and runs the commands. FOLDER holds the
records and matrices of the benchmark; see `iasc_asce.py`, whose frame is the model. Each row is one way to look at the frame:

- `forced`: faces and columns, the histories and the forces that drove them, which run straight between samples; the damping
  ratio of all modes is sought as well. Cases 1, 3 and 4.
- `ambient`: the same frame and masses, the accelerations alone: modes by `structid modes`, which are the record of the study.
- `condensed`: cases 2 and 5. The drawn frame of 120 degrees of freedom brought to the 12 of the floors (Guyan), less its
  braces, as matrices, and the braces of each face as springs that are sought. Modes of the accelerations alone.
- `storeys`: cases 2 and 5 with one spring a storey and direction, as if floors did not let columns turn: a model that is wrong,
  which the verdict must say.

Printed are verdict, losses of storeys beside the true ones, and which 95 % intervals do not hold the truth: of stiffnesses
where the model has such (`forced`, `ambient`), of losses otherwise. An answer with more of these than chance leaves, one in
four and one more, and without the verdict `wrong_model` is called false.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from iasc_asce import (
    COLUMNS,
    EXTRA_INERTIA,
    EXTRA_MASS,
    FACES,
    HALF,
    HEIGHT,
    INERTIA,
    LOST,
    MASS,
    NOISE,
    STOREY,
    TURNING,
)

ROWS = {"forced": (1, 3, 4), "ambient": (1, 3, 4), "condensed": (2, 5), "storeys": (2, 5)}
FLOORS, PATTERNS, Z95 = (20, 30, 40, 50), (0, 1, 2, 3, 4, 6), 1.959964
SENSORS = [f"{floor + face}{axis.upper()}" for floor in FLOORS for face, (_, axis) in FACES.items()]
BRACES = {axis: STOREY[axis] - COLUMNS[axis] for axis in "xy"}
MODES = "structid modes {record} --array acceleration --sampling-rate 500 --quantity acceleration --channels {channels}"


def table(kind: str, **keys: object) -> str:
    """One table of an array."""
    return "\n".join([f"[[{kind}]]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items()), ""])


def springs(name: str, at: int, direction: str, stiffness: float) -> str:
    """From each floor to the one below, at the node `at` of each."""
    first, second = [f"{f - 10 + at}{direction}" for f in FLOORS], [f"{f + at}{direction}" for f in FLOORS]
    return table("structure.spring", name=name, first=first, second=second, stiffness=stiffness)


def nodes_and_floors(heavy: bool) -> str:
    """Centres and faces of all floors, and a slab that is heavier."""
    lines = ["[structure.nodes]"]
    for k in range(5):
        lines.append(f"{10 * k + 10} = [{HALF}, {HALF}, {k * HEIGHT:.1f}]")
        lines += [f"{10 * k + 10 + f} = [{x}, {y}, {k * HEIGHT:.1f}]" for f, ((x, y), _) in FACES.items()]
    lines += ["59 = [0.625, 0.625, 3.6]", ""] if heavy else [""]
    for floor in FLOORS:
        own = [floor + face for face in FACES] + ([59] if heavy and floor == 50 else [])
        lines.append(table("structure.rigid_link", name=f"floor {floor // 10 - 1}", main=floor, dependents=own))
    return "\n".join(lines)


def masses(heavy: bool) -> str:
    """As weighed."""
    parts = [
        table("structure.point_mass", name="floors", nodes=FLOORS, mass=MASS, directions=["X", "Y"]),
        table("structure.rotary_inertia", name="turning", nodes=FLOORS, rotary_inertia=INERTIA, direction="RZ"),
    ]
    if heavy:
        parts += [
            table("structure.point_mass", name="slab", nodes=[59], mass=EXTRA_MASS, directions=["X", "Y"]),
            table("structure.rotary_inertia", name="slab turning", nodes=[50], rotary_inertia=EXTRA_INERTIA, direction="RZ"),
        ]  # fmt: skip
    return "\n".join(parts)


def study(row: str, case: int, pattern: int, folder: Path, out: Path) -> Path:
    """The study file of one state."""
    heavy, forced = case in (4, 5), row == "forced"
    axes = "y" if case in (1, 2) else "xy"
    fixed = ["10"] if row == "storeys" else [f"{10 + k} X Y RZ" for k in range(5)]
    head = f'title = "IASC-ASCE case {case}, pattern {pattern}: {row}"\n\n[structure]\nactive = ["X", "Y", "RZ"]\n'
    text = head + f"fixed = {json.dumps(fixed)}\n{'damping_ratio = 0.01' if forced else ''}\n\n"
    if row == "condensed":
        condensed(folder, case, out)
        text += f"[structure.matrices]\ndofs = {json.dumps([f'{f}{d}' for f in FLOORS for d in ('X', 'Y', 'RZ')])}\n\n"
        text += nodes_and_floors(False)
        text += table("structure.matrix_group", name="frame", mass=f"c{case}_mass.npy", stiffness=f"c{case}_bare.npy")
    else:
        text += nodes_and_floors(heavy) + masses(heavy)
    sought = []
    if row == "storeys":
        turning = sum(BRACES[a] + 2 * COLUMNS[a] / 3 for a in "xy") * HALF**2
        kinds = [("storey x", 0, "X", STOREY["x"]), ("storey y", 0, "Y", STOREY["y"]), ("turning", 0, "RZ", turning)]
        sought = ["storey y"] if axes == "y" else [name for name, *_ in kinds]
    else:
        faces = {
            f: (BRACES[a] if row == "condensed" else STOREY[a] - COLUMNS[a] / 3) / 2 for f, (_, a) in FACES.items()
        }
        kinds = [(f"face {f}", f, FACES[f][1].upper(), value) for f, value in faces.items()]
        sought = [f"face {f}" for f, (_, axis) in FACES.items() if axis in axes]
        if row != "condensed":
            kinds += [(f"middle columns {a}", 0, a.upper(), COLUMNS[a] / 3) for a in "xy"]
            kinds += [("turning columns", 0, "RZ", TURNING)]
    for name, at, direction, stiffness in kinds:
        text += springs(name, at, direction, stiffness)
        if name in sought:
            own: dict[str, object] = {"property": "stiffness", "elements": name, "each": True}
            prior = f'prior = {{ mean = {stiffness}, relative_std = 0.5, kind = "lognormal" }}\n' if forced else ""
            text += (
                table("unknown", **own, **({"positive": False} if row == "condensed" else {})).rstrip() + f"\n{prior}\n"
            )
    if forced:
        text += table("unknown", property="damping_ratio", elements="all modes")
        text += histories(folder, case, pattern, out)
    else:
        text += f'[record]\npath = "c{case}_p{pattern}_modes/modes.json"\n\n[record.modes]\n'
    path = out / f"{row}_c{case}_p{pattern}.toml"
    path.write_text(text)
    return path


def histories(folder: Path, case: int, pattern: int, out: Path) -> str:
    """``[record]`` of accelerations and forces, which are put into one array first."""
    with np.load(folder / f"c{case}_p{pattern}.npz") as file:
        acceleration, force = (file[name].astype(float) for name in ("acceleration", "force"))
        rate = float(file["sampling_rate"])
    np.savez(out / f"c{case}_p{pattern}.npz", values=np.hstack([acceleration, force]))
    loads = [f"{floor}Y" for floor in FLOORS] if case == 1 else ["50X", "50Y"]
    std = NOISE * np.sqrt((acceleration**2).mean(axis=0).max() / (1 + NOISE**2))
    kinds, noise = ["acceleration"] * 16 + ["force"] * len(loads), [float(f"{std:.4g}")] * 16 + [0.0] * len(loads)
    return "\n".join([
        "[record]", f'path = "c{case}_p{pattern}.npz"', 'array = "values"', f"sampling_rate = {rate}",
        f"channels = {json.dumps(SENSORS + loads)}", f"quantities = {json.dumps(kinds)}", "",
        "[record.time]", 'hold = "first"   # the forces of a simulation, straight between samples', f"noise = {noise}", "",
        "[method]", "band = [2.0, 60.0]", "",
    ])  # fmt: skip


def condensed(folder: Path, case: int, out: Path) -> None:
    """Mass of the floors and stiffness without braces of the drawn frame, 12 by 12, as .npy files."""
    with np.load(folder / f"c{case}_matrices_p0.npz") as file:
        mass, stiffness = file["M"], file["K"]
    follows = np.vstack([np.eye(12), -np.linalg.solve(stiffness[12:, 12:], stiffness[12:, :12])])
    mass, stiffness = (follows.T @ one @ follows for one in (mass, stiffness))
    for storey in range(4):
        for (x, y), axis in FACES.values():
            row = np.zeros(12)
            row[3 * storey : 3 * storey + 3] = (1, 0, HALF - y) if axis == "x" else (0, 1, x - HALF)
            if storey:
                row[3 * storey - 3 : 3 * storey] = -row[3 * storey : 3 * storey + 3]
            stiffness -= BRACES[axis] / 2 * np.outer(row, row)
    for name, one in (("mass", mass), ("bare", stiffness)):
        np.save(out / f"c{case}_{name}.npy", 0.5 * (one + one.T))


def ran(command: list[str]) -> float:
    """Seconds that a command of structid takes; its words go to a file beside its results."""
    began = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "structid", *command], capture_output=True, text=True, check=False)
    if done.returncode == 2:
        raise SystemExit(f"structid {' '.join(command)}\n{done.stderr}")
    return time.perf_counter() - began


def found(
    row: str, results: Path
) -> tuple[dict[tuple[int, str], float], dict[tuple[int, str], float], dict[str, object]]:
    """Stiffness that is sought of every storey and direction, N/m, its standard deviation, and all that was written."""
    answer = json.loads((results / "estimate.json").read_text())
    value: dict[tuple[int, str], float] = {}
    place: dict[tuple[int, str], list[int]] = {}
    for k, one in enumerate(answer["parameters"]):
        kind, _, inner = one["name"].partition("[")
        name, _, storey = inner.rstrip("]").rpartition(":")
        if kind == "stiffness" and not name.startswith("turning"):
            axis = name[-1] if row == "storeys" else FACES[int(name[-1])][1]
            value[int(storey), axis] = value.get((int(storey), axis), 0.0) + one["value"]
            place.setdefault((int(storey), axis), []).append(k)
    std = np.array([one["std"] if one["std"] is not None else np.nan for one in answer["parameters"]])
    correlation = np.array(answer["correlation"], dtype=float)
    covariance = correlation * np.outer(std, std)
    return value, {key: float(np.sqrt(covariance[np.ix_(p, p)].sum())) for key, p in place.items()}, answer


def report(row: str, case: int, pattern: int, results: Path, healthy: Path) -> bool:
    """Prints one state beside the truth; whether nothing false is said of it."""
    value, std, answer = found(row, results)
    before, before_std, _ = found(row, healthy)
    rest = {axis: COLUMNS[axis] / 3 if row in ("forced", "ambient") else 0.0 for axis in "xy"}
    words, outside = [], []
    for storey, axis in value:
        true_loss, key = LOST[pattern].get((storey, axis), 0.0), (storey, axis)
        whole = STOREY[axis] if row == "condensed" else before[key] + rest[axis]
        loss, spread = (before[key] - value[key]) / whole, np.hypot(std[key], before_std[key]) / whole
        if row in ("forced", "ambient"):
            true = STOREY[axis] * (1 - true_loss) - rest[axis]
            is_out = abs(value[key] - true) > Z95 * std[key]
        else:
            is_out = pattern > 0 and abs(loss - true_loss) > Z95 * spread
        outside += [f"{storey}{axis}"] if is_out else []
        words.append(f"{storey}{axis} {100 * loss:.2f} ({100 * true_loss:.2f}) +- {100 * spread:.2f}")
    verdict = answer["verdict"]
    print(f"{row}, case {case}, pattern {pattern}: {verdict}; loss % (true): {', '.join(words)}")
    print(f"    {answer['verdict_text']}")
    print(
        f"    95 % intervals without the truth: {len(outside)} of {len(value)}{': ' if outside else ''}{' '.join(outside)}",
        flush=True,
    )
    return verdict == "wrong_model" or len(outside) <= 1 + len(value) // 4


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--cases", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--patterns", type=int, nargs="+", default=list(PATTERNS))
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    false = []
    for row in given.rows:
        for case in [case for case in ROWS[row] if case in given.cases]:
            for pattern in given.patterns:
                record = given.folder / f"c{case}_p{pattern}.npz"
                if not record.exists():
                    continue
                path = study(row, case, pattern, given.folder, given.out)
                if given.write:
                    continue
                seconds, modes = 0.0, given.out / f"c{case}_p{pattern}_modes"
                if row != "forced" and not modes.exists():
                    words = MODES.format(record=record, channels=",".join(SENSORS)).split()[1:]
                    seconds += ran([*words, "--out", str(modes), "--no-report"])
                results = [given.out / f"{row}_c{case}_p{p}_results" for p in (pattern, 0)]
                seconds += ran(["identify", str(path), "--out", str(results[0]), "--no-report"])
                false += [] if report(row, case, pattern, *results) else [f"{row} c{case} p{pattern}"]
                print(f"    {seconds:.0f} s", flush=True)
    print(f"false answers without the verdict wrong_model: {', '.join(false) or 'none'}")
    return bool(false)


if __name__ == "__main__":
    sys.exit(main())
