"""Changes of a whole set or of the mesh: few, and screened by the changed study itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from structid.criticism.candidate import Candidate
from structid.explanation.trial import Trial
from structid.fem import Spring, Structure
from structid.fem.elements import ElementSet
from structid.fem.elements.element import declarations
from structid.fem.matrices.contribution import Property
from structid.forward import FrfProblem
from structid.forward.scatter import scatter_problems
from structid.unknowns import Parameters
from structid.unknowns.scatter import BEGUN

_PIECES = 3.0
_ELASTIC = ("mass", "stiffness", "rotary_inertia")
#: Bending stiffness over shear stiffness and squared length of a set, of a first guess.
_SHEAR = 0.02
#: Factors on it: short pieces of many beams in one set are stiffer by far.
_STIFFER = np.array([1.0, 10.0, 100.0])
#: Records of which a scatter is told from one that stands out: of fewer, the one is the likelier cause.
_FEWEST_VARYING = 5
#: Shear stiffnesses of beams, with the bending stiffness of the same plane.
_SHEARS = {
    "shear_stiffness": "bending_stiffness",
    "shear_stiffness_z": "bending_stiffness_y",
    "shear_stiffness_y": "bending_stiffness_z",
}
#: Of the loss factor that a set has, with how much viscous damping begins beside it; as much again looks worse at first.
_VISCOUS_PART = 0.3
#: Sets that are tried one by one.
_MOST_SLENDER = 6


def study_candidates(trial: Trial) -> Iterator[Candidate]:
    """Mesh, shear, the law of damping, windows, properties held at what the model says, and what differs among records."""
    setup = trial.setups[0]
    structure = setup.structure
    middle = float(np.median(np.concatenate([p.frequency for p in trial.problems])))
    if structure.divisible:
        yield _candidate("mesh", ("all lines",), _PIECES)
    yield from _shearing(structure)
    laws = [one for element in structure.elements for one in _damping(element, middle)]
    yield from laws
    viscous = [one for one in laws if one.where[-1] == "viscous"]
    if len(viscous) > 1:
        sets = (*(one.where[0] for one in viscous), "viscous")
        yield replace(viscous[0], where=sets, strengths=np.median([one.strengths for one in viscous], axis=0))
    held = held_candidates(structure, setup.parameters)
    yield from held
    for material in dict.fromkeys(_property(one) for one in held):
        names = tuple(one.where[0] for one in held if _property(one) == material)
        if len(names) > 1:  # of one material
            yield _candidate("held", names, 1.0)
    yield from _varying(trial)
    responses = [p for p in trial.problems if isinstance(p, FrfProblem)]
    if len(responses) == len(trial.problems):
        if all(p.channels is None or "window_decay" not in p.channels.kinds for p in responses):
            yield _candidate("window", ("all channels",), 0.002 * 2 * np.pi * middle)
        if all(p.record.segment is None for p in responses):
            yield _candidate("leakage", ("all channels",), 1.0)


def held_candidates(structure: Structure, unknown: Parameters) -> tuple[Candidate, ...]:
    """Every mass and stiffness of a set that no parameter changes, as one that is free."""
    return tuple(
        _candidate("held", (f"{item.term.property}[{item.element}]",), 1.0)
        for item in structure.properties
        if item.term.kind in _ELASTIC and item.term.values.any() and not _acts(unknown, item.values)
    )


def _property(held: Candidate) -> str:
    return held.where[0].partition("[")[0]


def _varying(trial: Trial) -> Iterator[Candidate]:
    """Each parameter that several records share, with a value of its own in each."""
    known = {name for problem in trial.problems for scatter in problem.parameters.scatters for name in scatter.own}
    known |= {common for one in scatter_problems(trial.problems) for common in one.names}
    counts: dict[str, int] = {}
    for problem in trial.problems:
        names, kinds, lower = problem.parameters.names, problem.parameters.kinds, problem.parameters.transforms.lower
        for name, kind, low in zip(names, kinds, lower.tolist(), strict=True):
            if kind in _ELASTIC and low >= 0 and name not in known:
                counts[name] = counts.get(name, 0) + 1
    for name, count in counts.items():
        if count >= _FEWEST_VARYING:
            yield _candidate("varies", (name,), BEGUN)


def _candidate(kind: str, where: tuple[str, ...], strength: float) -> Candidate:
    return Candidate(kind, where, strengths=np.array([strength]))


def _shearing(structure: Structure) -> Iterator[Candidate]:
    """Beams that are taken as slender, of each way in which they bend: all sets, and each of a few."""
    bends = [one for one in structure.properties if one.term.property in _SHEARS.values() and _moves(structure, one)]
    acting = {(one.element, one.term.property) for one in bends}
    for shear, bending in _SHEARS.items():
        slender = [
            one
            for one in structure.elements
            if shear in declarations(one) and vars(one)[shear] is None and (one.name, bending) in acting
        ]
        guesses = [_stiff(structure, one, bending) for one in slender]
        if len(slender) > 1:
            names = tuple(one.name for one in slender)
            yield _sheared(names, shear, float(np.median(guesses)))
        if len(slender) <= _MOST_SLENDER:
            for one, guess in zip(slender, guesses, strict=True):
                yield _sheared((one.name,), shear, guess)


def _moves(structure: Structure, item: Property) -> bool:
    """Whether a stiffness acts on free degrees of freedom."""
    own = [part for part in structure.contributions if part.law == "elastic" and part.value == item.values]
    return any(part.blocks.assemble(part.weights(structure.values)).count_nonzero() for part in own)


def _sheared(where: tuple[str, ...], shear: str, guess: float) -> Candidate:
    return Candidate("shear", where, strengths=guess * _STIFFER, others=(shear,))


def _stiff(structure: Structure, element: ElementSet, bending: str) -> float:
    ends = np.array([[structure.nodes[n] for n in pair] for pair in element.nodes.tolist()])
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    return float(np.mean(vars(element)[bending]) / (_SHEAR * length**2))


def _damping(element: ElementSet, middle: float) -> Iterator[Candidate]:
    """The other law of damping beside the one that a set has."""
    known = declarations(element)
    if "loss_factor" not in known:
        return
    loss = np.asarray(vars(element)["loss_factor"], dtype=float)
    if loss.any():
        if "stiffness_damping" in known or isinstance(element, Spring):
            strengths = np.array([_VISCOUS_PART * np.mean(loss) / (2 * np.pi * middle)])
            yield Candidate("damping_law", (element.name, "viscous"), strengths=strengths, detail={"frequency": middle})
    else:
        yield _candidate("damping_law", (element.name, "loss factor"), 0.005)


def _acts(unknown: Parameters, values: slice) -> bool:
    """Whether a parameter changes these values."""
    return bool(unknown.design.tocsr()[values.start : values.stop].nnz)
