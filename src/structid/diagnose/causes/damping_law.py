"""Damping follows another law than the model says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from structid.core.display import join_words
from structid.core.dof import Dof
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.model_edits import AddPart, AddUnknown, Edit, Edits, SetProperty, rounded
from structid.diagnose.tested_model import TestedModel
from structid.fem import Spring
from structid.fem.elements import ElementSet
from structid.fem.elements.element import declarations
from structid.forward import RecordProblem

#: Of the loss factor that a set has, with how much viscous damping begins beside it; as much again looks worse at first.
_VISCOUS_PART = 0.3
_FIRST_LOSS = 0.005
_STIFFNESSES = ("bending_stiffness", "axial_stiffness", "youngs_modulus")


@dataclass(frozen=True, eq=False, kw_only=True)
class DampingLaw(Candidate):
    """Viscous damping beside loss factors, or a loss factor where there is none.

    Attributes
    ----------
    frequency : float
        In the middle of the data, Hz.
    """

    kind: ClassVar[str] = "damping_law"
    frequency: float = 0.0

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """Candidates for the damping law that an element set does not have, one for each set, and one for all together.

        A set with a loss factor may be viscous, one without may have a loss factor. If several may be viscous, a last
        candidate has them all, with the median of their strengths. `problems` (one for each record) give the frequency
        in mid-band; sets are of the first record.
        """
        middle = float(np.median(np.concatenate([problem.frequency for problem in problems])))
        laws = [one for element in model.setups[0].structure.elements for one in cls._of_set(element, middle)]
        yield from laws
        viscous = [one for one in laws if one.where[-1] == "viscous"]
        if len(viscous) > 1:
            sets = (*(one.where[0] for one in viscous), "viscous")
            yield replace(viscous[0], where=sets, strengths=np.median([one.strengths for one in viscous], axis=0))

    @classmethod
    def _of_set(cls, element: ElementSet, middle: float) -> Iterator[DampingLaw]:
        """Candidate for the damping law that a set does not have: viscous for a set with a loss factor, and vice versa.

        `middle` is a frequency in mid-band, Hz, at which the viscous damping of the first guess is 30 % of that of the
        loss factor; its strength is in s. The strength for a loss factor is 0.005. Yields nothing for sets that can
        have no loss factor, or that have one and can have no viscous damping.
        """
        known = declarations(element)
        if "loss_factor" not in known:
            return
        loss = np.asarray(vars(element)["loss_factor"], dtype=float)
        if loss.any():
            if "stiffness_damping" in known or isinstance(element, Spring):
                strengths = np.array([_VISCOUS_PART * np.mean(loss) / (2 * np.pi * middle)])
                yield cls(where=(element.name, "viscous"), strengths=strengths, frequency=middle)
        else:
            yield cls(where=(element.name, "loss factor"), strengths=np.array([_FIRST_LOSS]))

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that give the sets a loss factor, or viscous damping beside their loss factor, as unknowns.

        `strength` is the loss factor, or the viscous damping over the stiffness in s. Springs get dashpots beside them;
        all other sets get half of it by stiffness and half by mass, each with one factor that the sets share as
        unknown.
        """
        *names, law = self.where
        edits: list[Edit] = []
        if law == "loss factor":
            for name in names:
                edits += [SetProperty(name, "loss_factor", rounded(strength)), _unknown("loss_factor", [name])]
            return edits
        sets = {one.name: one for setup in model.setups for one in setup.structure.elements if one.name in names}
        springs = [one for one in sets.values() if isinstance(one, Spring)]
        for spring in springs:
            name = model.unique_name(f"dashpots {spring.name}")
            ends = {"first": _names(spring.first)} | (
                {} if spring.second is None else {"second": _names(spring.second)}
            )
            damping = _plain([rounded(strength * k) for k in np.atleast_1d(spring.stiffness).tolist()])
            part = {"name": name, **ends, "viscous_damping": damping}
            edits += [AddPart("dashpot", part), _unknown("viscous_damping", [name])]
        others = [one for one in sets.values() if not isinstance(one, Spring)]
        share = strength / 2 if others else strength
        weights = {"stiffness_damping": share, "mass_damping": share * (2 * np.pi * self.frequency) ** 2}
        for prop, weight in weights.items():
            damped = [(one.name, damping) for one in others if any(damping := _viscous(one, prop, weight))]
            edits += [SetProperty(name, prop, _plain(damping)) for name, damping in damped]
            if damped:
                edits.append(_unknown(prop, [name for name, _ in damped], factor=True))
        return edits

    def sentence(self, value: float | None) -> str:
        return f"damping of {join_words(self.where[:-1])} is {self.where[-1]}"


def _plain(values: list[float]) -> float | list[float]:
    """The one value where all `values` are equal, otherwise the list of them; there must be some."""
    return values[0] if len(set(values)) == 1 else values


def _names(dofs: Sequence[Dof]) -> str | list[str]:
    """Names of degrees of freedom as a study writes them, such as ``3X`` or ``3X-``: one text, or a list of several."""
    names = [dof.place if dof.sign > 0 else f"{dof.place}-" for dof in dofs]
    return names[0] if len(names) == 1 else names


def _unknown(prop: str, names: list[str], **more: bool) -> AddUnknown:
    return AddUnknown({"property": prop, "elements": names if len(names) > 1 else names[0], **more})


def _viscous(element: ElementSet, prop: str, weight: float) -> list[float]:
    """Nominal viscous damping of each element: `weight` times its stiffness, or its mass for ``mass_damping``.

    `prop` is the name of the damping property, ``stiffness_damping`` or ``mass_damping``; a single 0 where the set does
    not have it. The mass is the set's ``mass`` or, without that, its ``density``.
    """
    known = declarations(element)
    key = next((key for key in (("mass", "density") if prop == "mass_damping" else _STIFFNESSES) if key in known), "")
    nominal = np.atleast_1d(np.asarray(vars(element)[key], dtype=float)) if key and prop in known else np.zeros(1)
    return [rounded(weight * value) for value in nominal.tolist()]
