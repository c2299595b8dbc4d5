"""The cantilever with six masses: record, model, and the fits that `six_masses.py` and `six_masses_frf.py` report.

The resonance frequencies of all arrangements are fitted together: positions of the masses differ, everything else is
shared. Masses are in units of the beam's own (1 kg/m is assumed). Every choice was made on the healthy state.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import linalg

import structid as sid
from structid.forward import RecordProblem
from structid.identification.joint_problem import harmonize_shared_parameters
from structid.identification.search import SearchOutcome, search_parameters
from structid.inversion import Linearization
from structid.inversion.problem import DataRows
from structid.inversion.search.work import SERIAL
from structid.inversion.state_comparison import LATER, Comparison, compare_jointly, states_problem
from structid.unknowns.tolerances import EXACT

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "beam_six_masses_frf" / "frf.npz"
LENGTH, THICKNESS = 0.38, 4.75e-3
MASSES = tuple(f"m{j}" for j in range(1, 7))
STATES = {"d296": 2.96, "d592": 5.92, "d887": 8.87}
#: Where the peak of each mode is looked for, and the half width of the lines that give its pole, Hz.
SEARCH = ((18, 26), (128, 152), (355, 425), (690, 775), (1080, 1215))
WIDTH = (1.6, 5.0, 9.0, 14.0, 30.0)
#: Error of a frequency, positions of the masses included, in parts: the healthy fit's own scatter.
ERROR = 0.003
#: E h^2 / (12 density) of steel and aluminium alike: bending stiffness at 1 kg/m, N m^2.
METAL = 26.3e6 * THICKNESS**2 / 12
#: Zero of a resonance that is none of the beam's: the same in all arrangements and states, Hz.
ALIEN = 777.2
TIP, HAMMER = 999, 500
#: Loss factor of the beam, without influence on its frequencies.
LOSS = 0.01
#: Longest element, m.
ELEMENT = 0.025


@dataclass(frozen=True)
class Model:
    """What a model of the cantilever has.

    Parameters
    ----------
    clamp : tuple of {"rotation", "inertia", "lift", "mass"}
        Rotational spring and inertia of the clamp, spring and mass against its moving sideways.
    rotary : bool
        Whether the masses have rotary inertia, the same for all.
    accelerometer : bool
        Whether the accelerometer has rotary inertia besides its mass.
    metal : float
        Standard deviation of the prior that the beam is of steel or aluminium, in parts; 0 for none.
    equal : bool
        Whether all six masses are one unknown.
    modes : tuple of int
        Modes whose frequencies are used, from 1.
    pull : float
        Product of the distances of the zero at `ALIEN` from the poles below and above it, Hz^2: by pull / (ALIEN - f4)
        that resonance, which is none of the beam's, holds f4 down. 0 leaves it out.
    varies : tuple of str
        Elements whose stiffness, mass or inertia differs from arrangement to arrangement: of "clamp", "clamp inertia", "tip"
        and "masses".
    error : float
        Error of a frequency, in parts.
    """

    clamp: tuple[str, ...] = ("rotation", "inertia")
    rotary: bool = True
    accelerometer: bool = False
    metal: float = 0.05
    equal: bool = False
    modes: tuple[int, ...] = (1, 2, 3, 4, 5)
    pull: float = 0.0
    varies: tuple[str, ...] = ()
    error: float = ERROR


@cache
def data(path: Path = DATA) -> dict[str, np.ndarray]:
    """Arrays of the file."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def values(state: str, k: int) -> np.ndarray:
    """The stored FRF of arrangement `k` (from 0) as complex numbers."""
    decibel, degrees = data()[state][k].T.astype(float)
    return 10 ** (decibel / 20) * np.exp(1j * np.deg2rad(degrees))


@cache
def poles(state: str, k: int) -> np.ndarray:
    """Frequency (Hz) and damping ratio of each mode, (5, 2): one pole and a straight background near each peak."""
    frequency, frf = data()["freq_hz"], values(state, k)
    found = []
    for (low, high), width in zip(SEARCH, WIDTH, strict=True):
        inside = np.flatnonzero((frequency >= low) & (frequency <= high))
        centre = frequency[inside[np.argmax(np.abs(frf[inside]))]]
        for _ in range(3):
            lines = np.abs(frequency - centre) <= width
            offset, h = (frequency[lines] - centre) / width, frf[lines]
            columns = np.stack([h, np.ones_like(h), offset.astype(complex)], axis=1) / np.sqrt(np.abs(h))[:, None]
            pole = np.linalg.lstsq(columns, h * offset / np.sqrt(np.abs(h)), rcond=None)[0][0] * width
            centre = centre + pole.real
        found.append((centre, pole.imag / centre))
    return np.array(found)


def cantilever(k: int, model: Model, hammer: float | None = None) -> sid.Structure:
    """The beam with the masses of arrangement `k` (from 0) and a node `hammer` m from the clamp, 1 kg/m."""
    keys = {0.0: 1, LENGTH: TIP} if hammer is None else {0.0: 1, hammer: HAMMER, LENGTH: TIP}
    keys.update({float(x): 101 + j for j, x in enumerate(data()["mass_position_cm"][k] / 100)})
    ends = sorted(keys)
    nodes: dict[int, tuple[float]] = {}
    for a, b in pairwise(ends):
        parts = max(1, int(np.ceil((b - a) / ELEMENT - 1e-9)))
        nodes[keys[a]] = (a,)
        nodes.update({1000 + len(nodes) + q: (a + (b - a) * q / parts,) for q in range(1, parts)})
    nodes[TIP] = (LENGTH,)
    labels, places = list(nodes), [101 + j for j in range(6)]
    elements: list[Any] = [sid.Beam("beam", list(pairwise(labels)), 1.0, METAL, 0.0, LOSS)]
    elements += [sid.PointMass(name, [place], 0.012) for name, place in zip(MASSES, places, strict=True)]
    elements += [sid.PointMass("tip", [TIP], 0.007), sid.Spring("clamp", "1RZ", stiffness=1900.0)]
    optional = {
        "clamp inertia": ("inertia" in model.clamp, sid.RotaryInertia("clamp inertia", [1], 5e-5, "RZ")),
        "clamp mass": ("mass" in model.clamp, sid.PointMass("clamp mass", [1], 0.2)),
        "clamp lift": ("lift" in model.clamp, sid.Spring("clamp lift", "1Y", stiffness=1.2e7)),
        "masses": (model.rotary, sid.RotaryInertia("masses", places, 3e-6, "RZ")),
        "accelerometer": (model.accelerometer, sid.RotaryInertia("accelerometer", [TIP], 1e-6, "RZ")),
    }
    elements += [element for used, element in optional.values() if used]
    return sid.Structure(nodes, elements, () if "lift" in model.clamp else ("1Y",))


def unknowns(structure: sid.Structure, model: Model, more: Sequence[sid.Unknown] = ()) -> sid.Parameters:
    """Stiffness of the beam, masses, accelerometer and clamp."""
    prior = sid.Prior(METAL, model.metal * METAL, "lognormal") if model.metal else None
    declared = [sid.Unknown("bending_stiffness", "beam", prior=prior)]
    each = [sid.Unknown("mass", name) for name in MASSES]
    declared += [sid.Unknown("mass", list(MASSES), name="each")] if model.equal else each
    declared += [
        sid.Unknown(quantity, name, varies=name in model.varies)
        for quantity, name in (("mass", "tip"), ("stiffness", "clamp"))
    ]
    extra = {
        "masses": "rotary_inertia",
        "clamp inertia": "rotary_inertia",
        "accelerometer": "rotary_inertia",
        "clamp mass": "mass",
        "clamp lift": "stiffness",
    }
    names = {element.name for element in structure.elements}
    return sid.parameters(
        structure,
        [*declared, *(sid.Unknown(q, n, varies=n in model.varies) for n, q in extra.items() if n in names), *more],
    )


@lru_cache(maxsize=512)
def mass_and_stiffness(structure: sid.Structure, parameters: sid.Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Each as the part without parameters and the derivatives, (1 + n_params, n, n)."""
    found = []
    for kind in ("mass", "stiffness"):
        points = np.vstack([np.zeros(parameters.n_params), np.eye(parameters.n_params)])
        parts = np.array([structure.matrix(kind, parameters.values(p)).toarray() for p in points])
        parts[1:] -= parts[0]
        found.append(parts)
    return found[0], found[1]


@dataclass(frozen=True, eq=False)
class ResonanceProblem(RecordProblem):
    """Parameters of an undamped structure from its lowest resonance frequencies: log(model / measured) / error."""

    structure: sid.Structure
    parameters: sid.Parameters
    measured: np.ndarray
    modes: tuple[int, ...]
    error: float = ERROR

    @property
    def frequency(self) -> np.ndarray:
        return self.measured

    @property
    def rows(self) -> DataRows:
        n = len(self.measured)
        return DataRows(np.arange(n), np.zeros(n, dtype=int), ("frequency",), np.array(self.modes))

    @property
    def matrices(self) -> tuple[np.ndarray, np.ndarray]:
        return mass_and_stiffness(self.structure, self.parameters)

    def predicted(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies in Hz and mode shapes of unit modal mass."""
        weights = np.concatenate([[1.0], self.physical(theta)])
        mass, stiffness = (np.tensordot(weights, parts, 1) for parts in self.matrices)
        squared, shapes = linalg.eigh(stiffness, mass, subset_by_index=[0, max(self.modes) - 1])
        used = np.array(self.modes) - 1
        return np.sqrt(squared[used]) / (2 * np.pi), shapes[:, used]

    def residual(self, theta: np.ndarray) -> np.ndarray:
        prior, _ = self.parameters.prior_rows(self.physical(theta))
        return np.concatenate([np.log(self.predicted(theta)[0] / self.frequency) / self.error, prior])

    def linearize(self, theta: np.ndarray) -> Linearization:
        frequency, shapes = self.predicted(theta)
        squared, slope = (2 * np.pi * frequency) ** 2, self.slope(theta)
        by_mass, by_stiffness = (np.einsum("im,pij,jm->mp", shapes, parts[1:], shapes) for parts in self.matrices)
        rows = 0.5 * (by_stiffness / squared[:, None] - by_mass) * slope / self.error
        prior, prior_slope = self.parameters.prior_rows(self.physical(theta))
        residual = np.concatenate([np.log(frequency / self.frequency) / self.error, prior])
        return Linearization(residual, np.concatenate([rows, prior_slope * slope]))


@dataclass(frozen=True)
class ListOfFrequencies:
    """What the search asks of a record besides its problem."""

    name: str
    own_estimator: str = ""
    calibration: float = 0.0


def problems(state: str, arrangements: Iterable[int], model: Model) -> list[ResonanceProblem]:
    """One an arrangement."""
    made = []
    for k in arrangements:
        structure, measured = cantilever(k, model), poles(state, k)[:, 0].copy()
        measured[3] += model.pull / (ALIEN - measured[3])
        used = measured[np.array(model.modes) - 1]
        made.append(ResonanceProblem(structure, unknowns(structure, model), used, model.modes, model.error))
    return made


def problem(state: str, arrangements: Iterable[int], model: Model) -> sid.JointProblem:
    """All arrangements of a state in one problem."""
    return sid.JointProblem(tuple(problems(state, arrangements, model)))


def fitted(state: str, arrangements: Iterable[int], model: Model) -> sid.Estimate:
    """One state alone."""
    return sid.estimate(problem(state, arrangements, model))


def answer(parts: Sequence[ResonanceProblem], titles: Sequence[str]) -> SearchOutcome:
    """All of them in one fit, with what varies among them."""
    options = sid.IdentifyOptions(restarts=0, pole_free_start=False, tolerances=EXACT)
    records = [ListOfFrequencies(title) for title in titles]
    return search_parameters(records, harmonize_shared_parameters(parts, titles), options, None, SERIAL)


def scatter(found: sid.Estimate, state: str, arrangements: Iterable[int], model: Model) -> np.ndarray:
    """Predicted over measured frequencies less 1 in %, of any arrangements, (n_arrangements, 5)."""
    parts = problem(state, arrangements, model).problems
    return 100 * ERROR * np.array([part.residual(found.theta)[: part.n_data] for part in parts])


def held_out(arrangements: Sequence[int], model: Model) -> np.ndarray:
    """Errors in % of the healthy arrangements that had no part in a fit to the other two thirds, (n, 5)."""
    errors = []
    for third in range(3):
        judged = list(arrangements[third::3])
        found = fitted("healthy", [k for k in arrangements if k not in judged], model)
        errors.append(scatter(found, "healthy", judged, model))
    return np.concatenate(errors)


def rms(errors: np.ndarray) -> str:
    """Root mean square of each mode and of all."""
    return " ".join(f"{x:5.2f}" for x in (*np.sqrt((errors**2).mean(axis=0)), np.sqrt((errors**2).mean())))


def shared(found: sid.JointProblem) -> tuple[str, ...]:
    """What a loss of mass leaves as it was: beam, clamp and accelerometer."""
    return tuple(n for n in found.names if n not in {f"mass[{m}]" for m in MASSES} and n != "rotary_inertia[masses]")


def both_states(state: str, arrangements: Sequence[int], model: Model) -> tuple[sid.Estimate, Comparison]:
    """The healthy and a later state in one fit, and what changed."""
    baseline = problem("healthy", arrangements, model)
    found = sid.estimate(states_problem(baseline, problem(state, arrangements, model), shared(baseline)))
    return found, compare_jointly(found, shared(baseline))


def loss(found: sid.Estimate, accelerometer: bool, covariance: np.ndarray | None = None) -> tuple[float, float, float]:
    """Mass lost, % of beam and healthy masses (and accelerometer), its standard deviation, and the total in beams."""
    before = np.array([name in {f"mass[{m}]" for m in MASSES} for name in found.names], float)
    after = np.array([name in {f"mass[{m}]{LATER}" for m in MASSES} for name in found.names], float)
    tip = np.array([name == "mass[tip]" for name in found.names], float) * accelerometer
    total = LENGTH + (before + tip) @ found.values
    share = (before - after) @ found.values / total
    gradient = (before - after - share * (before + tip)) / total
    used = found.covariance if covariance is None else covariance
    return 100 * share, 100 * float(np.sqrt(gradient @ used @ gradient)), total / LENGTH


def scatter_later(found: sid.Estimate, state: str, arrangements: Sequence[int], model: Model) -> np.ndarray:
    """The same as `scatter` for the later state of a joint fit."""
    known = dict(zip(found.names, found.theta, strict=True))
    parts = problem(state, arrangements, model).problems
    theta = [np.array([known.get(n + LATER, known.get(n)) for n in part.names], float) for part in parts]
    return 100 * ERROR * np.array([p.residual(t)[: p.n_data] for p, t in zip(parts, theta, strict=True)])
