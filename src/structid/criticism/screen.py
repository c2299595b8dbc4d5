"""The screen: how much of a misfit each candidate would take away, all other parameters following along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.arrays import FloatArray
from structid.criticism.candidate import Candidate
from structid.criticism.data import scaled_misfit
from structid.criticism.fields import Fields, fields_at
from structid.estimation import JointProblem
from structid.observation import FrfProblem

_SMALL = 1e-4


@dataclass(frozen=True, eq=False)
class Screened:
    """A candidate, the strength that removes most, and what it leaves of the sum of squares."""

    candidate: Candidate
    strength: float
    left: float


@dataclass(frozen=True, eq=False)
class Point:
    """Problems of FRFs at one point of their parameters, linearized.

    Attributes
    ----------
    records : tuple of Fields
    residual : (n_rows,) float array
        Whitened, of all records, then of priors.
    basis : (n_rows, n_params) float array
        Q of the Jacobian: what the parameters can follow.
    """

    records: tuple[Fields, ...]
    residual: FloatArray
    basis: FloatArray

    @property
    def left(self) -> float:
        """The sum of squares off the basis without any change."""
        return float(self._base @ self._base)

    def without(self, rows: np.ndarray) -> float:
        """What is left where some data rows (n_data,) count with the likeliest factor on their errors only."""
        keep = np.ones(len(self.residual), dtype=bool)
        keep[: len(rows)] = ~rows
        step, *_ = np.linalg.lstsq(self.basis[keep], self.residual[keep], rcond=None)
        rest = self.residual - self.basis @ step
        return float(rest[keep] @ rest[keep]) + scaled_misfit(float(rest[~keep] @ rest[~keep]), int((~keep).sum()))

    def screened(self, candidate: Candidate) -> Screened:
        """The best of the candidate's strengths, the linear estimate of it among them."""
        tried = self._tried(candidate, candidate.strengths)
        low, high = candidate.bounds
        if len(candidate.strengths) > 1:
            small = _SMALL * np.abs(candidate.strengths).min()
            slope = (self._off(candidate, np.array([small]))[:, 0] - self._base) / small
            size = slope @ slope
            step = -(slope @ self._base) / size if size > 0 else 0.0
            best = tried[0][int(np.argmin(tried[1]))]
            more = np.array([q for q in (0.5 * step, step, 2 * step, 0.75 * best, 1.35 * best) if low < q < high and q])
            if len(more):
                again = self._tried(candidate, more)
                tried = np.concatenate([tried[0], again[0]]), np.concatenate([tried[1], again[1]])
        k = int(np.argmin(tried[1]))
        return Screened(candidate, float(tried[0][k]), float(tried[1][k]))

    @cached_property
    def _base(self) -> FloatArray:
        return self.residual - self.basis @ (self.basis.T @ self.residual)

    def _tried(self, candidate: Candidate, strengths: FloatArray) -> tuple[FloatArray, FloatArray]:
        off = self._off(candidate, strengths)
        left = np.einsum("ij,ij->j", off, off)
        return strengths, np.where(np.isfinite(left), left, np.inf)

    def _off(self, candidate: Candidate, strengths: FloatArray) -> FloatArray:
        """Residuals off the basis, (n_rows, n_strengths)."""
        rows = np.repeat(self.residual[:, None], len(strengths), axis=1)
        first = 0
        with np.errstate(all="ignore"):
            for number, fields in enumerate(self.records):
                size = fields.problem.n_data
                if candidate.record is None or candidate.record == number:
                    change = candidate.effect(fields, strengths)
                    rows[first : first + size] = fields.problem.data_rows(fields.frf + change)
                first += size
            found: FloatArray = rows - self.basis @ (self.basis.T @ rows)
        return found


def point_at(problems: Sequence[FrfProblem], theta: FloatArray) -> Point:
    """Problems at free variables of all their parameters together, on a part of their lines."""
    columns = JointProblem(tuple(problems), first_prior_counts=True).columns
    records = tuple(fields_at(problem, theta[index]) for problem, index in zip(problems, columns, strict=True))
    whole = JointProblem(tuple(fields.problem for fields in records), first_prior_counts=True)
    at = whole.linearize(theta)
    return Point(records, at.residual, np.linalg.qr(at.jacobian)[0])
