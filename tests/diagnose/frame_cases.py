"""A portal frame with a part of every kind of change that can be written in a study, and its FRFs or histories."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.dof import parse_dofs
from structid.dynamics.normal_modes import modes
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes
from structid.modal.modal_record import independent_errors
from structid.records import FrfRecord, TimeRecord
from structid.records.formats import write_record
from structid.study.run.start import study_problems
from structid.study.schema.study import load_study

STUDY = """\
title = "Portal"

[structure]
subdivide = 1
tolerance = 0
active = ["X", "Y", "RZ"]
fixed = ["1 X Y RZ", "6X", "6Y", "6RZ"]

[structure.nodes]
1 = [0.0, 0.0]
2 = [0.0, 0.5]
3 = [0.0, 1.0]
4 = [0.6, 1.0]
5 = [1.2, 1.0]
6 = [1.2, 0.0]

[[structure.beam]]
name = "left"
nodes = [[1, 2], [2, 3]]
mass = 4.0
bending_stiffness = 600.0
axial_stiffness = 3e5
loss_factor = 0.02

[[structure.beam]]
name = "girder"
nodes = [[3, 4], [4, 5]]
mass = 3.0
bending_stiffness = 800.0
axial_stiffness = 3e5
loss_factor = 0.02

[[structure.beam]]
name = "right"
nodes = [[5, 6]]
mass = 4.0
bending_stiffness = 550.0
axial_stiffness = 3e5
loss_factor = 0.02

[[structure.spring]]
name = "brace"
first = "2X"
second = "4X"
stiffness = 2000.0

[[unknown]]
property = "bending_stiffness"
elements = "left"

[[unknown]]
property = "bending_stiffness"
elements = "girder"

[[unknown]]
property = "mass"
elements = ["left", "girder"]

# how the test was made
[record]
calibration = 0
path = "frf.npz"

[record.noise]
relative = 0.01
absolute = 1e-6

[method]
restarts = 0
"""
BASE = '[[structure.base]]\nname = "table"\nsupports = ["1X", "6X"]\n\n'
FREQUENCY = np.linspace(2.0, 60.0, 120)


def written(folder: Path, text: str = STUDY, truth: str = STUDY, seed: int | None = 1) -> Path:
    """The path of a study whose record is that of `truth`, with the noise stated, or without where there is no seed."""
    outputs, inputs, kind = ["2X", "3X", "4Y", "5Y"], ["4Y"], "receptance"
    if BASE in truth:
        inputs, kind = ["1X"], "transmissibility"
    blank = np.ones((len(FREQUENCY), len(outputs), len(inputs)), complex)
    write_record(folder / "frf.npz", FrfRecord(FREQUENCY, blank, outputs, inputs, kind))
    path = folder / "study.toml"
    path.write_text(truth, encoding="utf-8")
    [problem] = study_problems(load_study(path))
    values = problem.predicted(problem.theta_start)
    if seed is not None:
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
        values = values + noise / np.sqrt(2) * np.hypot(0.01 * np.abs(values), 1e-6)
    write_record(folder / "frf.npz", FrfRecord(FREQUENCY, values, outputs, inputs, kind))
    path.write_text(text, encoding="utf-8")
    return path


def shaken(text: str = STUDY) -> str:
    """The study with both feet on a table that moves along X in place of a force."""
    return text.replace("[[unknown]]", BASE + "[[unknown]]", 1)


def written_shaken(folder: Path, seed: int | None = 1) -> Path:
    """The same with transmissibilities from the table."""
    return written(folder, shaken(), shaken(), seed)


def written_with_machine(folder: Path, seed: int | None = 1) -> Path:
    """The same with a machine at the girder, of which FRFs at two degrees of freedom are known: two masses on springs."""
    s = 2j * np.pi * FREQUENCY[:, None, None]
    mass, stiffness = np.diag([0.4, 0.7, 0.5]), np.array([[9e3, -9e3, 0], [-9e3, 1.6e4, -7e3], [0, -7e3, 7e3]])
    receptance = np.linalg.inv(s**2 * mass + stiffness * (1 + 0.03j))[:, [[0], [2]], [0, 2]]
    write_record(folder / "machine.npz", FrfRecord(FREQUENCY, receptance, ["4Y", "5Y"], ["4Y", "5Y"], "receptance"))
    machine = '[[structure.measured_component]]\nname = "machine"\npath = "machine.npz"\n\n[[unknown]]'
    text = STUDY.replace("[[unknown]]", machine, 1)
    return written(folder, text, text, seed)


def off(text: str = STUDY) -> str:
    """The study with starts that are some percent off."""
    return text.replace("bending_stiffness = 600.0", "bending_stiffness = 660.0").replace("= 800.0", "= 750.0")


def of_histories(text: str = STUDY) -> str:
    """The study with histories in place of FRFs."""
    noise = text[text.index("[record.noise]") : text.index("[method]")]
    timed = "[record.time]\nrelative_noise = 0.01\ntransient = false\n\n"
    return text.replace('path = "frf.npz"', 'path = "time.npz"').replace(noise, timed).replace(
        "restarts = 0", "restarts = 0\nband = [2.0, 60.0]"
    )  # fmt: skip


def written_histories(
    folder: Path,
    text: str | None = None,
    truth: str = STUDY,
    seed: int | None = 1,
    gains: dict[int, float] | None = None,
    hum: float = 0.0,
) -> Path:
    """The same with one period of accelerations and a random force at 4Y; `gains` are those of its columns, the force first,
    and `hum` is the level of mains at 50 Hz and 25 Hz in all motions.
    """
    rate, n_times = 150.0, 1500
    frequency = np.fft.rfftfreq(n_times, 1 / rate)[1:-1]
    outputs, inputs = ["2X", "3X", "4Y", "5Y"], ["4Y"]
    blank = np.ones((len(frequency), len(outputs), 1), complex)
    write_record(folder / "frf.npz", FrfRecord(frequency, blank, outputs, inputs, "accelerance"))
    path = folder / "study.toml"
    path.write_text(truth, encoding="utf-8")
    [problem] = study_problems(load_study(path))
    h = problem.predicted(problem.theta_start)[:, :, 0]
    rng = np.random.default_rng(0)
    force = np.where(frequency < 65.0, np.exp(2j * np.pi * rng.uniform(size=len(frequency))), 0.0)
    lines = np.zeros((n_times // 2 + 1, 5), complex)
    lines[1:-1] = np.column_stack([force, h * force[:, None]])
    values = np.fft.irfft(lines, n_times, axis=0)
    if seed is not None:
        noise = np.random.default_rng(seed).standard_normal(values.shape)
        values = values + 0.01 * np.sqrt((values**2).mean(axis=0)) * noise
    for column, gain in (gains or {}).items():
        values[:, column] *= gain
    seconds = np.arange(n_times)[:, None] / rate
    tones = np.sin(2 * np.pi * 50.013 * seconds + np.arange(4)) + 0.3 * np.cos(2 * np.pi * 25.0065 * seconds)
    values[:, 1:] += hum * values[:, 1:].std(axis=0) * tones
    kinds = ("force", *["acceleration"] * 4)
    write_record(folder / "time.npz", TimeRecord(rate, values, (*inputs, *outputs), kinds))
    path.write_text(of_histories() if text is None else text, encoding="utf-8")
    return path


def of_modes(text: str = STUDY) -> str:
    """The study with modes in place of FRFs; masses are known then."""
    begin, end = text.index("[record.noise]"), text.index("[method]")
    mass = text[text.rindex("[[unknown]]") : text.index("# how the test")]
    return (
        (text[:begin] + "[record.modes]\n\n" + text[end:])
        .replace("frf.npz", "modes.json")
        .replace(mass, "")
        .replace("calibration = 0\n", "")
    )


def written_modes(folder: Path, gains: dict[str, float] | None = None, error: float = 1.0, seed: int = 1) -> Path:
    """The study with its first five modes, errors 0.1 % of frequencies and 1 % of shapes, `error` times as large as stated."""
    path, channels = written(folder), ["2X", "3X", "4X", "4Y", "5X", "5Y"]
    structure = load_study(path).setups[0].structure
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"))
    frequency, n = found.frequency[:5], 5
    shapes = structure.selection(parse_dofs(channels)).T @ found.mode_shapes[:, :n]
    shapes = shapes / np.abs(shapes).max(axis=0)
    for name, gain in (gains or {}).items():
        shapes[channels.index(name)] *= gain
    rng, std = np.random.default_rng(seed), 1e-3 * frequency
    frequency = frequency + error * std * rng.standard_normal(n)
    shapes = shapes + error * 0.01 * rng.standard_normal(shapes.shape)
    covariance = independent_errors(np.concatenate([std, np.full(n, 1e-3)]))
    record = ModalRecord(frequency, np.full(n, 0.01), shapes, channels, covariance, np.full(shapes.shape, 0.01))
    write_modes(folder / "modes.json", record)
    path.write_text(of_modes(off()), encoding="utf-8")
    return path
