"""Small structures, forces and records for the tests of identification in the time domain."""

import numpy as np

from structid import Dashpot, PointMass, Spring, Structure, TimeRecord, Unknown, parameters
from structid.forward import TimeOptions, simulated_time_record


def chain(n=3):
    """Masses on a line, sprung and damped to each other and to the ground at the left end."""
    rng = np.random.default_rng(5)
    here = [f"{i + 1}X" for i in range(1, n)]
    left = [f"{i}X" for i in range(1, n)]
    parts = [
        PointMass("m", list(range(1, n + 1)), rng.uniform(1, 2, n)),
        Spring("wall", "1X", stiffness=60.0),
        Spring("k", left, here, stiffness=rng.uniform(50, 100, n - 1)),
        Dashpot("oil", "1X", viscous_damping=0.5),
        Dashpot("c", left, here, viscous_damping=rng.uniform(0.5, 1, n - 1)),
    ]
    return Structure({i: float(i) for i in range(1, n + 1)}, parts, active=["X"])


def undamped_free(n=3):
    """The same masses and springs without wall and dampers: one rigid-body mode."""
    parts = [e for e in chain(n).elements if e.name in ("m", "k")]
    return Structure({i: float(i) for i in range(1, n + 1)}, parts, active=["X"])


def everything(structure):
    """All masses, springs and dashpots that the structure has."""
    kinds = {"m": "mass", "wall": "stiffness", "k": "stiffness", "oil": "viscous_damping", "c": "viscous_damping"}
    return parameters(structure, [Unknown(kinds[e.name], e.name, each=True) for e in structure.elements])


def record_of(
    structure, unknown, sensors, n=200, rate=20.0, noise=0.02, loads=("1X",), seed=0, rng=None, options=None,
    initial=None, force_noise=0.0,
):  # fmt: skip
    """Motion under random forces; `sensors` pairs of degree of freedom and quantity; noise as a part of each RMS.

    The forces and the true motion depend on `seed` only, the noise on `rng` (none without it).
    """
    force = np.random.default_rng(seed).standard_normal((n, len(loads)))
    dofs = (*[s for s, _ in sensors], *loads)
    kinds = (*[q for _, q in sensors], *["force"] * len(loads))
    blank = TimeRecord(rate, np.column_stack([np.zeros((n, len(sensors))), force]), dofs, kinds)
    clean = simulated_time_record(structure, unknown, blank, options or TimeOptions(), initial=initial)
    rms = np.sqrt((clean.values**2).mean(axis=0))
    variance = (noise * rms) ** 2
    variance[len(sensors) :] = (force_noise * rms[len(sensors) :]) ** 2
    values = clean.values
    if rng is not None:
        values = values + np.sqrt(variance) * rng.standard_normal(values.shape)
    return TimeRecord(rate, values, dofs, kinds, variance)


def all_of(structure, *quantities):
    """Every degree of freedom with each of these quantities."""
    return [(str(d), q) for q in quantities for d in structure.dofs]


def off(unknown, spread=0.2, seed=9):
    """The same parameters started at random, off by `spread`."""
    rng = np.random.default_rng(seed)
    return unknown.started_at(unknown.start * np.exp(spread * rng.standard_normal(unknown.n_params)))
