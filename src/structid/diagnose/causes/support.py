"""A support gives way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import join_words
from structid.core.dof import Dof, parse_dof
from structid.core.errors import InputError
from structid.diagnose.causes.candidate import POSITIVE, Candidate, added_spring
from structid.diagnose.effects import effect_of_release, strengths_about
from structid.diagnose.model_edits import (
    AddNode,
    Edit,
    Edits,
    HoldSupports,
    MoveBaseSupport,
    ReleaseSupport,
    renamed_channels,
    rounded,
)
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel


@dataclass(frozen=True, eq=False, kw_only=True)
class Support(Candidate):
    """A direction, or several together, that some record holds or drives, and that is flexible; the strength is its compliance.

    Attributes
    ----------
    driven : tuple of int
        Positions of the records whose input is at the support.
    loss_factor : float, optional
        Loss factor of the spring that takes the place of the support, as an unknown of its own; None without one.
    """

    kind: ClassVar[str] = "support"
    bounds: tuple[float, float] = POSITIVE
    driven: tuple[int, ...] = ()
    loss_factor: float | None = None

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """A candidate flexible support for each direction that is fixed or driven in some record and could be released.

        `records` are the receptances of each record. Strengths are compliances, m/N or rad/(N m): 0.005 to 60 times the
        inverse of the structure's dynamic stiffness at the support, all else fixed, by the first record that has it.
        `record_names` are not used.
        """
        inputs = [{dof.unsigned for dof in one.problem.record.inputs} for one in records]
        scales = {
            dof.unsigned: float(1 / np.median(np.abs(own)))
            for one in reversed(records)
            for dof, own in zip(one.loose[0], one.loose[2].T, strict=True)
        }
        for dof, scale in scales.items():
            driven = tuple(number for number, own in enumerate(inputs) if dof in own)
            yield cls(where=(dof.place,), strengths=strengths_about(scale), driven=driven)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        """Changes of a record's FRFs, (n_strengths, n_lines, n_outputs, n_inputs), by a compliance of the support.

        The support is the first of `self.where`. Zero for a record that neither holds nor drives it. `strengths`
        (n_strengths,) are compliances, m/N or rad/(N m), `receptances` those of the record.
        """
        held, coupling, own = receptances.loose
        dof = parse_dof(self.where[0])
        index = [i for i, one in enumerate(held) if one.unsigned == dof]
        if not index:  # this record neither holds nor drives it
            return np.zeros((len(strengths), *receptances.frf.shape), complex)
        return effect_of_release(receptances, coupling[:, :, index[0]], own[:, index[0]], strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that replace the supports in `self.where` by springs to the ground, or to a node that the base moves.

        Their stiffness is one unknown, which starts at the inverse of the compliance `strength` (m/N or rad/(N m)). If
        `self.loss_factor` is not None, the springs have that loss factor, as a further unknown.

        Raises
        ------
        InputError
            If one of the directions is fixed in no record.
        """
        dof = parse_dof(self.where[0])
        held = {one.unsigned for setup in model.setups for one in setup.structure.fixed}
        if not held.issuperset(parse_dof(place) for place in self.where):
            raise InputError(f"{join_words(self.where)} is not held")
        to_base, end = self._driving_end(model, dof)
        name = model.unique_name(f"support {self.where[0]}")
        first = list(self.where) if len(self.where) > 1 else self.where[0]
        entry = {"name": name, "first": first, **end, "stiffness": rounded(1 / strength)}
        released = [ReleaseSupport(parse_dof(place)) for place in self.where]
        return [*to_base, *released, *added_spring("spring", entry, self.loss_factor)]

    def _driving_end(self, model: TestedModel, dof: Dof) -> tuple[list[Edit], dict[str, str]]:
        """Edits for a support at `dof` that a base drives, and the argument ``second`` of its spring; else both empty.

        The second end is a new node at the position of the first, that moves with the base; records driven there get
        its name for their channel.
        """
        if not any(base.moves(dof) for setup in model.setups for base in setup.structure.bases):
            return [], {}
        label = model.new_node()
        end = f"{label}{dof.direction}"
        renamed = [renamed_channels(model, number, {dof.place: end}) for number in self.driven]
        return [AddNode(label, dof.node), MoveBaseSupport(dof, label), HoldSupports((end,)), *renamed], {"second": end}

    def sentence(self, value: float | None) -> str:
        if len(self.where) > 1:
            return f"the supports {join_words(self.where)} are flexible"
        return f"the support {self.where[0]} is flexible"
