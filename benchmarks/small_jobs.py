"""Processor time of small studies as a user runs them, what they load, and how deep a residual lies below the command.

    python benchmarks/small_jobs.py [demo gantry building] [--beside OTHER/src] [--rounds 3] [--no-explain] [--small]

- `demo`: `examples/three_storey_frame`, measured FRFs, 18 degrees of freedom.
- `gantry`: a gantry crane of 107 degrees of freedom, 2000 lines of six simulated FRFs with 2 % noise (seed 5), eight unknowns.
- `building`: the IASC-ASCE building by histories, case 1 without damage; it is left out where its records are not there.

Each is `structid identify STUDY --workers 1` with one thread in a process of its own; user and system time of the process,
the median of `--rounds`. `--beside` runs the structid of another tree in turn with this one, prints the ratio, and fails where
`estimate.json` differs from it. Then, of the first study: modules of structid and of SciPy that are loaded at the end, and
frames from the command to the first residual. `--small` has 60 lines and no search for causes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.forward.simulation import simulated_record

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data" / "iasc_asce_phase_1"
JOBS = ("demo", "gantry", "building")
#: True values of the gantry over those that its study starts from.
TRUTH = np.array([1.12, 0.82, 0.95, 1.1, 0.9, 1.05, 1.08, 1.3])
HEIGHT, SPAN, TRACK = 6.0, 12.0, 3.0  # m
#: Sections: mass, two bending stiffnesses, axial and torsional stiffness, and a vector that is not along the line.
SECTIONS = {
    "legs left": (60.0, 8e6, 5e6, 1.5e9, 4e6, [0, 1, 0]),
    "legs right": (60.0, 8e6, 5e6, 1.5e9, 4e6, [0, 1, 0]),
    "girder front": (90.0, 2.5e7, 1.2e7, 2.2e9, 8e6, [0, 1, 0]),
    "girder back": (90.0, 2.5e7, 1.2e7, 2.2e9, 8e6, [0, 1, 0]),
    "end beams": (45.0, 6e6, 6e6, 1.0e9, 3e6, [1, 0, 0]),
}
UNKNOWNS = (
    ("mass", "trolley"),
    ("bending_stiffness_y", "legs left"),
    ("bending_stiffness_y", "legs right"),
    ("bending_stiffness_z", "legs left"),
    ("bending_stiffness_y", "girder front"),
    ("bending_stiffness_y", "girder back"),
    ("mass", "girder front"),
)
#: The command with the names of the modules that it has loaded written at its end.
LOADED = """
import json, runpy, sys
out = sys.argv.pop(1)
try:
    runpy.run_module("structid", run_name="__main__", alter_sys=True)
finally:
    json.dump(sorted(sys.modules), open(out, "w"))
"""
#: The command, ended at its first residual of FRFs, with the functions of structid above it written.
FRAMES = """
import json, os, runpy, sys, traceback
out = sys.argv.pop(1)
from structid.forward import FrfProblem
def residual(problem, theta):
    calls = [call for call in traceback.extract_stack() if "/structid/" in call.filename]
    names = [f"{call.filename.split('/structid/')[-1]} {call.name}" for call in calls]
    with open(out, "w") as file:
        json.dump(names, file)
    os._exit(0)
FrfProblem.residual = residual
runpy.run_module("structid", run_name="__main__", alter_sys=True)
"""


def main() -> int:
    """Print the figures; 1 where an answer differs from that of the other tree."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", default=list(JOBS), help=", ".join(JOBS))
    parser.add_argument("--beside", type=Path, help="src of another tree, run in turn with this one")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--no-explain", action="store_true", help="no search for causes")
    parser.add_argument("--small", action="store_true")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.jobs) - set(JOBS))
    if unknown:
        parser.error(f"no job is called {', '.join(unknown)}; jobs are {', '.join(JOBS)}")
    if arguments.rounds < 1:
        parser.error(f"--rounds must be at least 1, got {arguments.rounds}")
    flags = ["--no-explain"] * (arguments.no_explain or arguments.small)
    is_same = True
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        studies = {job: study_of(job, folder, arguments.small) for job in arguments.jobs}
        known = {job: study for job, study in studies.items() if study is not None}
        for job, study in known.items():
            is_same &= compared(job, study, arguments.beside, arguments.rounds, flags)
        if known:
            loaded_and_deep(next(iter(known.values())), flags)
    return int(not is_same)


def study_of(job: str, folder: Path, is_small: bool) -> Path | None:
    """The study file of a job in a folder of its own; None where its records are not there."""
    place = folder / job
    if job == "demo":
        shutil.copytree(ROOT / "examples" / "three_storey_frame", place)
        return thinned(place / "study.toml") if is_small else place / "study.toml"
    place.mkdir()
    if job == "gantry":
        return write_gantry(place, 60 if is_small else 2000)
    if not DATA.is_dir():
        print("building: its records are not here")
        return None
    sys.path.insert(0, str(ROOT / "benchmarks" / "accuracy"))
    from iasc_asce_studies import study

    return study("forced", 1, 0, DATA, place)


def thinned(study: Path) -> Path:
    """The study of the demo with every twentieth line of its record."""
    record = dict(np.load(study.with_name("frf.npz")))
    few = {name: values[::20] if len(values) > 20 else values for name, values in record.items()}
    np.savez(study.with_name("frf.npz"), **few)
    return study


def write_gantry(place: Path, n_lines: int) -> Path:
    """The study of the gantry and its simulated FRFs at `n_lines` lines from 1 to 60 Hz."""
    corners = {1: (0.0, 0.0), 2: (0.0, TRACK), 3: (SPAN, 0.0), 4: (SPAN, TRACK)}
    nodes = {100 * c + j: (x, y, HEIGHT * j / 3) for c, (x, y) in corners.items() for j in range(4)}
    nodes |= {500 + 10 * k + i: (SPAN * i / 4, k * TRACK, HEIGHT) for k in range(2) for i in (1, 2, 3)}
    leg = {c: [[100 * c + j, 100 * c + j + 1] for j in range(3)] for c in corners}
    girder = [[[103, 501], [501, 502], [502, 503], [503, 303]], [[203, 511], [511, 512], [512, 513], [513, 403]]]
    lines = [leg[1] + leg[2], leg[3] + leg[4], *girder, [[103, 203], [303, 403]]]
    held = [f"{100 * c}{d}" for c in corners for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    parts = ['title = "Gantry"', "[structure]", f"fixed = {json.dumps([*held, '103RX'])}", "subdivide = 1"]
    parts += ["[structure.nodes]", *(f"{label} = {list(at)}" for label, at in nodes.items())]
    for (name, section), pairs in zip(SECTIONS.items(), lines, strict=True):
        mass, bending_y, bending_z, axial, torsional, across = section
        parts += ["[[structure.space_beam]]", f'name = "{name}"', f"nodes = {pairs}", f"mass = {mass}"]
        parts += [f"bending_stiffness_y = {bending_y}", f"bending_stiffness_z = {bending_z}"]
        parts += [f"axial_stiffness = {axial}", f"torsional_stiffness = {torsional}"]
        parts += ["loss_factor = 0.02", f"orientation = {across}"]
    parts += ["[[structure.point_mass]]", 'name = "trolley"', "nodes = [502, 512]", "mass = 400.0"]
    for quantity, name in UNKNOWNS:
        parts += ["[[unknown]]", f'property = "{quantity}"', f'elements = "{name}"']
    parts += ["[[unknown]]", 'property = "loss_factor"', f"elements = {json.dumps(list(SECTIONS))}", 'name = "steel"']
    parts += ["[record]", 'path = "frf.npz"', 'array = "accelerance"', 'frequency_array = "freq_hz"']
    parts += ['kind = "accelerance"', 'outputs = ["102X", "103X", "203Y", "502Z", "512Z", "303X"]', 'inputs = ["103X"]']
    parts += ["[record.noise]", "relative = 0.02"]
    study = place / "study.toml"
    study.write_text("\n".join(parts) + "\n", encoding="utf-8")
    frequency = np.linspace(1.0, 60.0, n_lines)
    np.savez(place / "frf.npz", accelerance=np.ones((n_lines, 6, 1), complex), freq_hz=frequency)
    read = sid.load_study(study)
    parameters = read.parameters.started_at(read.parameters.start * TRUTH)
    like = sid.FrfRecord(
        frequency, np.ones((n_lines, 6, 1), complex), ["102X", "103X", "203Y", "502Z", "512Z", "303X"], ["103X"],
        kind="accelerance",
    )  # fmt: skip
    record = simulated_record(read.structure, parameters, like, 0.02, np.random.default_rng(5))
    np.savez(place / "frf.npz", accelerance=record.values, freq_hz=frequency)
    return study


def compared(job: str, study: Path, beside: Path | None, rounds: int, flags: list[str]) -> bool:
    """Print the processor time of a job, beside that of another tree in turn; False where the answers differ."""
    trees = {"this": ROOT / "src"} | ({} if beside is None else {"other": beside.resolve()})
    seconds: dict[str, list[float]] = {name: [] for name in trees}
    for _ in range(rounds):
        for name, source in trees.items():
            command = ["-m", "structid", "identify", study.name, "--workers", "1", "--out", f"out_{name}", *flags]
            seconds[name].append(run(source, study.parent, command))
    medians = {name: statistics.median(several) for name, several in seconds.items()}
    line = f"{job}: {medians['this']:.1f} s ({', '.join(f'{one:.1f}' for one in seconds['this'])})"
    if beside is None:
        print(line)
        return True
    answers = [answer(study.parent / f"out_{name}" / "estimate.json") for name in trees]
    is_same = answers[0] == answers[1]
    words = "the same answer" if is_same else "ANOTHER ANSWER"
    print(f"{line}; other tree {medians['other']:.1f} s, ratio {medians['this'] / medians['other']:.3f}, {words}")
    return is_same


def answer(path: Path) -> dict[str, object]:
    """What `estimate.json` says, without when and by what it was made and which folder it names."""
    text = path.read_text(encoding="utf-8").replace("out_this", "out").replace("out_other", "out")
    return {name: value for name, value in json.loads(text).items() if name != "provenance"}


def loaded_and_deep(study: Path, flags: list[str]) -> None:
    """Print the modules that an identification loads and the frames from the command to its first residual."""
    out, command = study.with_name("names.json"), ["identify", study.name, "--workers", "1", "--out", "out", *flags]
    run(ROOT / "src", study.parent, ["-c", LOADED, str(out), *command])
    names = json.loads(out.read_text())
    counts = {package: sum(name.partition(".")[0] == package for name in names) for package in ("structid", "scipy")}
    print(f"modules loaded: {counts['structid']} of structid, {counts['scipy']} of SciPy, {len(names)} in all")
    run(ROOT / "src", study.parent, ["-c", FRAMES, str(out), *command])
    frames = json.loads(out.read_text())
    print(f"frames of structid to the first residual: {len(frames)}", *frames, sep="\n  ")


def run(source: Path, folder: Path, arguments: list[str]) -> float:
    """Run Python with `arguments` in `folder`, with the structid of `source`, and return its processor time in s."""
    before = processor_seconds()
    environment = {**os.environ, "PYTHONPATH": str(source), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 1, 3):
        raise RuntimeError(done.stderr)
    return processor_seconds() - before


def processor_seconds() -> float:
    """Processor time of the processes that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


if __name__ == "__main__":
    sys.exit(main())
