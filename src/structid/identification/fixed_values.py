"""The values that the models of several records hold, as unknowns beside those that are sought."""

from __future__ import annotations

from collections.abc import Sequence

from structid.forward import RecordProblem
from structid.forward.fixed_values import with_fixed_values
from structid.identification.joint_problem import joint_problem, joint_sample
from structid.identification.setups.setup import AnySetup, titles
from structid.inversion.fixed_values import FIXED
from structid.inversion.search.within_tolerances import FixedValues
from structid.unknowns.tolerances import Tolerances


def freed_problems(
    setups: Sequence[AnySetup], problems: Sequence[RecordProblem], tolerances: Tolerances
) -> tuple[RecordProblem, ...]:
    """The problem of each record with the fixed values of its model among its unknowns; see `with_fixed_values`."""
    named = zip(setups, titles(setups), problems, strict=True)
    return tuple(with_fixed_values(problem, tolerances, setup.calibration, title) for setup, title, problem in named)


def tolerances_of(freed: Sequence[RecordProblem]) -> dict[str, float]:
    """Tolerances of the fixed values among the unknowns of `freed` problems, by the names of these unknowns."""
    held = [(part.names, part.held[1].tolist()) for one in freed for part in one.parts if part.held is not None]
    pairs = [pair for names, deviations in held for pair in zip(names, deviations, strict=True)]
    return {name: float(std) for name, std in pairs if name.startswith(FIXED)}


def fixed_values(freed: Sequence[RecordProblem]) -> FixedValues | None:
    """The fixed values that are free in the `freed` problems, the same in all records; None where there are none."""
    known = tolerances_of(freed)
    return FixedValues(joint_problem(freed), known, joint_sample(freed)) if known else None
