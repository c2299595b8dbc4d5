"""The test: readings of a structure with its faults, as the user's files hold them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from scipy.signal import resample

from wrong_models.assembly import TRANSLATIONS, Table, assembled, shaken, split
from wrong_models.faults import AFTER_NOISE, BEFORE_NOISE, Fault, Readings
from wrong_models.response import DERIVATIVES, Sensor, averaged, band_limited, frf, h1, history, looked, modes, steady
from wrong_models.rigs import Rig

#: Noise: of FRFs and histories in parts of each value or of a channel's rms, with a floor in parts of the rms of all.
RELATIVE, FLOOR = 0.01, 3e-4
#: Of modes: of frequencies, and of shapes in parts of the largest entry.
FREQUENCY_ERROR, SHAPE_ERROR = 0.001, 0.01
#: Shaker force, N rms; force noise in parts of it; samples of histories and of one period of periodic noise.
FORCE, FORCE_NOISE, SAMPLES, PERIOD = 10.0, 0.001, 2048, 1024
#: Steps of the simulation between two samples.
FINE = 8
#: Lines of an FRF, and of each of several set-ups.
LINES, STATE_LINES = 300, 120
AVERAGES = 12


def seen_by(label: str, faults: Sequence[Fault]) -> Sensor:
    """What a sensor really looks at: "direction 5Y X@30" is turned by 30 degrees towards X."""
    node, direction = split(label)
    for fault in faults:
        if fault.kind == "direction" and fault.where == label:
            other, angle = fault.size.split("@")
            turn = np.radians(float(angle))
            return {label: float(np.cos(turn)), f"{node}{other}": float(np.sin(turn))}
    return {f"{node}{direction}": 1.0}


def modal_sensors(rig: Rig) -> list[str]:
    """At most twelve translations that move, those of the rig's sensors among them."""
    free = [dof for dof in assembled(rig.table).dofs if split(dof)[1] in TRANSLATIONS]
    extra = [dof for dof in free if dof not in rig.sensors]
    chosen = set(rig.sensors) | set(extra[:: max(1, -(-len(extra) // max(1, 12 - len(rig.sensors))))])
    return [dof for dof in free if dof in chosen]


def measured(
    rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator, noisy: bool = True
) -> Readings:
    """Readings of the structure `table` in the test `record` of `rig`, with the faults of the record."""
    made = TESTS[re.sub(r"\d+$", "", record)](rig, table, record, faults, rng)
    for fault in faults:
        if fault.kind in BEFORE_NOISE:
            BEFORE_NOISE[fault.kind](made, fault)
    if noisy:
        _noise(made, rng)
    for fault in faults:
        if fault.kind in AFTER_NOISE:
            AFTER_NOISE[fault.kind](made, fault, rng)
    return made


def _noise(made: Readings, rng: np.random.Generator) -> None:
    """Noise on everything that has not been averaged with noise already."""
    if made.std is not None:  # modes
        made.axis = made.axis * (1 + FREQUENCY_ERROR * rng.standard_normal(made.axis.shape))
        made.motion = made.motion + made.std * rng.standard_normal(made.motion.shape)
    elif made.force is not None:
        made.motion = made.motion + RELATIVE * made.motion.std(axis=0) * rng.standard_normal(made.motion.shape)
        made.force = made.force + FORCE_NOISE * made.force.std(axis=0) * rng.standard_normal(made.force.shape)
    elif made.coherence is None:
        noise = rng.standard_normal(made.motion.shape) + 1j * rng.standard_normal(made.motion.shape)
        made.motion = made.motion + noise_of(made.motion) * noise / np.sqrt(2)


def floor_of(values: np.ndarray) -> float:
    """The part of FRF noise that does not go with the value."""
    return float(f"{FLOOR * np.sqrt((abs(values) ** 2).mean()):.3g}")


def straightened(force: np.ndarray) -> np.ndarray:
    """Samples (n, 1) of a force that repeats whose straight lines have the spectrum of the smooth `force`."""
    spectrum = np.fft.rfft(force, axis=0)
    return np.fft.irfft(spectrum / np.sinc(np.fft.rfftfreq(len(force)))[:, None] ** 2, len(force), axis=0)


def noise_of(values: np.ndarray) -> np.ndarray:
    """Standard deviation of each complex FRF value."""
    return np.sqrt((RELATIVE * abs(values)) ** 2 + floor_of(values) ** 2)


def _frf(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """FRFs; "frf2" of two loads, "states" with fewer lines. A window that nobody has told adds decay."""
    loads = list(rig.loads[: 2 if record.endswith("2") else 1])
    decay = sum(fault.amount for fault in faults if fault.kind == "window")
    n = STATE_LINES if record.startswith("states") else LINES
    axis = rig.band[0] + float(f"{(rig.band[1] - rig.band[0]) / (n - 1):.3g}") * np.arange(n)
    seen = [seen_by(label, faults) for label in rig.sensors]
    return Readings(axis, frf(assembled(table), axis, seen, loads, rig.kind, decay), list(rig.sensors), loads)


def _shaken(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """Motion per motion of the table."""
    return _frf(rig, shaken(table), "frf", faults, rng)


def _quake(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """Histories from rest on the table."""
    return _time(rig, shaken(table), "time", faults, rng)


def _hits(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """H1 and coherence of a few hits ("hits5") with noise on the response, which goes with its spectrum."""
    made, n = _frf(rig, table, "frf", faults, rng), int(record[4:])
    clean = made.motion[:, :, 0]
    size = noise_of(clean) * np.sqrt(n)
    x = _complex(rng, (n, len(made.axis)))
    y = clean * x[:, :, None] + size * _complex(rng, (n, *clean.shape))
    values, coherence = averaged(x, y)
    return Readings(
        made.axis, values[:, :, None], made.sensors, made.loads, coherence=coherence[:, :, None], averages=n
    )


def _complex(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Unit complex normal numbers."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def rate_of(rig: Rig) -> float:
    """Sampling rate of histories, Hz; its step has three digits, which every format keeps."""
    return 1 / float(f"{1 / (3 * rig.band[1]):.3g}")


def _force(rig: Rig, rng: np.random.Generator, n: int) -> np.ndarray:
    """Periodic noise in the band of the test, (n, 1)."""
    return FORCE * band_limited(rng, n, rate_of(rig), 0.5 * rig.band[0], 1.1 * rig.band[1])[:, None]


def _motion(rig: Rig, table: Table, faults: Sequence[Fault], force: np.ndarray) -> np.ndarray:
    """What the sensors read under a force that repeats; with friction after four periods from rest."""
    system, seen, load = assembled(table), [seen_by(label, faults) for label in rig.sensors], [rig.loads[0]]
    if "friction" not in table:
        return steady(system, force, rate_of(rig), seen, load, rig.kind)
    n, rest = FINE * len(force), 0 if force[0, 0] == 0 else 4  # a force that begins at zero begins from rest
    fine = resample(force, n)
    whole = np.tile(straightened(fine), (rest + 1, 1))
    found = history(system, whole, load, 1 / (FINE * rate_of(rig)), table["friction"])
    return (found[DERIVATIVES[rig.kind]] @ looked(system, seen).T)[rest * n :: FINE]


def _time(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """Histories from rest under random force: the beginning of one that fades in and, much later, out."""
    force, ramp = np.zeros((8 * SAMPLES, 1)), np.sin(np.linspace(0, np.pi / 2, 32))[:, None] ** 2
    force[: SAMPLES + 64] = _force(rig, rng, SAMPLES + 64)
    force[:32] *= ramp
    force[SAMPLES + 32 : SAMPLES + 64] *= ramp[::-1]
    motion = _motion(rig, table, faults, force)
    axis = np.arange(SAMPLES) / rate_of(rig)
    return Readings(axis, motion[:SAMPLES], list(rig.sensors), [rig.loads[0]], force[:SAMPLES])


def _h1(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """Histories under noise that repeats, eight periods of it, after its start has died away."""
    force = _force(rig, rng, PERIOD)
    motion = _motion(rig, table, faults, force)
    axis = np.arange(8 * PERIOD) / rate_of(rig)
    return Readings(axis, np.tile(motion, (8, 1)), list(rig.sensors), [rig.loads[0]], np.tile(force, (8, 1)))


def _random(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """FRFs and coherence as an analyser makes them of many periodic noises, each after its start has died away.

    With `window` the analyser averages segments of continuous noise instead: their leakage is in the FRFs.
    """
    step = rate_of(rig) / PERIOD
    lines = np.arange(int(np.ceil(rig.band[0] / step)), int(rig.band[1] / step) + 1)
    if any(fault.kind == "window" for fault in faults):
        force = _force(rig, rng, PERIOD * AVERAGES)
        motion = _noisy(_motion(rig, table, faults, force), rng)
        values, coherence, n = h1(force[:, 0], motion, PERIOD)
    else:
        forces = [_force(rig, rng, PERIOD) for _ in range(AVERAGES)]
        motions = [_noisy(_motion(rig, table, faults, force), rng) for force in forces]
        values, coherence = averaged(np.fft.rfft(forces, axis=1)[:, :, 0], np.fft.rfft(motions, axis=1))
        n = AVERAGES
    coherence = np.clip(coherence[lines, :, None], 0.0, 1.0)
    return Readings(
        lines * step, values[lines, :, None], list(rig.sensors), [rig.loads[0]], coherence=coherence, averages=n
    )


def _noisy(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return motion + RELATIVE * motion.std(axis=0) * rng.standard_normal(motion.shape)


def _modal(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """Frequencies and shapes, each shape 1 at its largest entry."""
    sensors, system = modal_sensors(rig), assembled(table)
    frequency, damping, shapes = modes(system, rig.n_modes)
    rows = (looked(system, [seen_by(label, faults) for label in sensors]) @ shapes).T
    rows /= rows[np.arange(len(rows)), abs(rows).argmax(axis=1)][:, None]
    return Readings(frequency, rows, sensors, [], damping=damping, std=np.full(rows.shape, SHAPE_ERROR))


def _ambient(rig: Rig, table: Table, record: str, faults: Sequence[Fault], rng: np.random.Generator) -> Readings:
    """Motion under forces that nobody measures, at every translation, 12000 samples."""
    rate, n = rate_of(rig), 12000
    sensors, system = modal_sensors(rig), assembled(table)
    loads = [dof for dof in system.dofs if split(dof)[1] in TRANSLATIONS]
    force = np.stack([band_limited(rng, n, rate, 0.1 * rig.band[0], 1.25 * rig.band[1]) for _ in loads], axis=1)
    motion = steady(system, force, rate, [seen_by(label, faults) for label in sensors], loads, "accelerance")
    return Readings(np.arange(n) / rate, motion, sensors, [], force=np.zeros((n, 0)))


TESTS = {
    "frf": _frf, "states": _frf, "hits": _hits, "time": _time, "h": _h1, "random": _random, "modal": _modal,
    "modalstates": _modal, "ambient": _ambient, "shaken": _shaken, "quake": _quake,
}  # fmt: skip
#: Tests whose histories are simulated in time, which takes viscous damping.
VISCOUS = ("time", "h1", "random", "ambient", "quake")
