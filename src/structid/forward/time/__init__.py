"""Time histories as least-squares problems."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeGuard

from structid.forward.record_problem import RecordProblem

if TYPE_CHECKING:
    from structid.forward.time.spectra import SpectraProblem


def compares_spectra(problem: object) -> TypeGuard[SpectraProblem]:
    """True for a problem of finite Fourier transforms of histories; the test does not import `SpectraProblem`."""
    return isinstance(problem, RecordProblem) and problem.compares_spectra
