"""Changes of a whole set or of the mesh: few, and screened by the changed study itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from structid.criticism.candidate import Candidate
from structid.explanation.trial import Trial
from structid.observation import FrfProblem
from structid.structure import Beam, Spring, Structure
from structid.structure.elements import ElementSet
from structid.structure.elements.element import declarations
from structid.unknowns import Parameters

_PIECES = 3.0
#: Bending stiffness over shear stiffness and squared length of a set, of a first guess.
_SHEAR = 0.02
#: Sets that are tried one by one.
_MOST_SLENDER = 6


def study_candidates(trial: Trial) -> Iterator[Candidate]:
    """Mesh, shear, the law of damping, windows, and properties that are held at what the model says."""
    setup = trial.setups[0]
    structure, unknown = setup.structure, setup.parameters
    middle = float(np.median(np.concatenate([p.frequency for p in trial.problems])))
    if any(element.nodes.ndim == 2 and element.nodes.shape[1] == 2 for element in structure.elements):
        yield _candidate("mesh", ("all lines",), _PIECES)
    slender = [one for one in structure.elements if isinstance(one, Beam) and one.shear_stiffness is None]
    if len(slender) > 1:
        names = tuple(one.name for one in slender)
        yield _candidate("shear", names, float(np.median([_stiff(structure, one) for one in slender])))
    for one in slender if len(slender) <= _MOST_SLENDER else ():
        yield _candidate("shear", (one.name,), _stiff(structure, one))
    for element in structure.elements:
        yield from _damping(element, middle)
    for item in structure.properties:
        values = item.term.values
        is_elastic = item.term.kind in ("mass", "stiffness", "rotary_inertia")
        if is_elastic and values.any() and not _acts(unknown, item.values):
            yield _candidate("held", (f"{item.term.property}[{item.element}]",), 1.0)
    if all(
        isinstance(p, FrfProblem) and (p.channels is None or "window_decay" not in p.channels.kinds)
        for p in trial.problems
    ):
        yield _candidate("window", ("all channels",), 0.002 * 2 * np.pi * middle)


def _candidate(kind: str, where: tuple[str, ...], strength: float) -> Candidate:
    return Candidate(kind, where, strengths=np.array([strength]))


def _stiff(structure: Structure, element: Beam) -> float:
    ends = np.array([[structure.nodes[n] for n in pair] for pair in element.nodes.tolist()])
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    return float(np.mean(element.bending_stiffness) / (_SHEAR * length**2))


def _damping(element: ElementSet, middle: float) -> Iterator[Candidate]:
    """The other law of damping beside the one that a set has."""
    known = declarations(element)
    if "loss_factor" not in known:
        return
    loss = np.asarray(vars(element)["loss_factor"], dtype=float)
    if loss.any():
        if "stiffness_damping" in known or isinstance(element, Spring):
            yield _candidate("damping_law", (element.name, "viscous"), float(np.mean(loss)) / (2 * np.pi * middle))
    else:
        yield _candidate("damping_law", (element.name, "loss factor"), 0.005)


def _acts(unknown: Parameters, values: slice) -> bool:
    """Whether a parameter changes these values."""
    return bool(unknown.design.tocsr()[values.start : values.stop].nnz)
