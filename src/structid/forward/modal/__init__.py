"""Modes as a least-squares problem."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeGuard

from structid.forward.record_problem import RecordProblem

if TYPE_CHECKING:
    from structid.forward.modal.problem import ModalProblem


def compares_modes(problem: object) -> TypeGuard[ModalProblem]:
    """True for a problem that compares measured modes with a model's; the test does not import `ModalProblem`."""
    return isinstance(problem, RecordProblem) and problem.compares_modes
