"""A planned test, and how well it would determine each parameter, beside its alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.constraints import Count, Positive
from structid.core.dof import Dof
from structid.fem import Structure
from structid.inversion import Identifiability
from structid.inversion.diagnostics.design import Criterion
from structid.records.record import FrfKind
from structid.unknowns import Parameters


@dataclass(frozen=True)
class PlanOptions:
    """Options of a planned test: candidate sensors and loads, lines and noise.

    Parameters
    ----------
    frequency : sequence of float
        Candidate lines, Hz, increasing.
    sensors : sequence of Dof
        Candidate sensors; every free translation of the structure by default.
    loads : sequence of Dof
        Candidate loads; the installed ones by default, or every free translation where there is none. Of transmissibility
        supports that drive the structure; by default one of each base.
    installed_sensors, installed_loads : sequence of Dof
        What is there already. It is a candidate too.
    kind : {"receptance", "mobility", "accelerance", "transmissibility"}
        Of the frequency response functions.
    relative_noise, absolute_noise : float
        Standard deviation of the complex noise: a part of each value's magnitude, and in the SI unit of `kind`.
    n_sensors, n_loads : int, optional
        How many to choose; by default as many as are installed, or four sensors and one load.
    n_frequencies : int, optional
        How many lines to choose; all of them are used by default.
    criterion : {"d", "a"}
        Determinant (D-optimality) or trace (A-optimality) of the covariance of the relative parameters.
    of_interest : sequence of str
        Parameters, by name or property, whose accuracy counts; all by default. The others stay unknown.
    target : float, optional
        Relative standard deviation that every parameter of interest should reach.
    """

    frequency: Sequence[float]
    sensors: Sequence[Dof] = ()
    loads: Sequence[Dof] = ()
    installed_sensors: Sequence[Dof] = ()
    installed_loads: Sequence[Dof] = ()
    kind: FrfKind = "accelerance"
    relative_noise: float = 0.01
    absolute_noise: float = 0.0
    n_sensors: Count | None = None
    n_loads: Count | None = None
    n_frequencies: Count | None = None
    criterion: Criterion = "d"
    of_interest: Sequence[str] = ()
    target: Positive | None = None


@dataclass(frozen=True, eq=False)
class PlannedTest:
    """One possible test and the accuracy that it would have.

    Attributes
    ----------
    label : str
    sensors, loads : tuple of Dof
    frequency : (n_lines,) float array
        Hz.
    std : (n_params,) float array
        Predicted relative standard deviation of each parameter, priors included: the Cramer-Rao bound at the initial
        values; NaN where it is not determined.
    of_interest : (n_params,) bool array
    of_tolerances : (n_params,) float array
        Relative standard deviation that the tolerances of fixed values and of the calibration give each parameter besides, which
        neither more lines nor more averages lessen; zeros where all is exact.
    """

    label: str
    sensors: tuple[Dof, ...]
    loads: tuple[Dof, ...]
    frequency: FloatArray
    std: FloatArray
    of_interest: np.ndarray
    of_tolerances: FloatArray

    @property
    def std_with_tolerances(self) -> FloatArray:
        """Relative standard deviation of each parameter from noise and tolerances, (n_params,)."""
        return np.hypot(self.std, self.of_tolerances)

    @property
    def worst_with_tolerances(self) -> float:
        """Largest `std_with_tolerances` of a parameter of interest; infinite if the test does not determine all of them."""
        worst = float(np.max(self.std_with_tolerances[self.of_interest]))
        return worst if np.isfinite(worst) else np.inf

    @property
    def worst(self) -> int:
        """Index of the parameter of interest with the largest relative standard deviation; NaN counts as infinite."""
        return int(np.argmax(np.where(self.of_interest, np.where(np.isnan(self.std), np.inf, self.std), -1.0)))

    @property
    def worst_std(self) -> float:
        """Relative standard deviation of the worst parameter; infinite where the test does not determine it."""
        return float(np.inf if np.isnan(self.std[self.worst]) else self.std[self.worst])

    @property
    def rms_std(self) -> float:
        """Root mean square of the relative deviations of the parameters of interest; infinite if not all are determined."""
        value = float(np.sqrt(np.mean(self.std[self.of_interest] ** 2)))
        return value if np.isfinite(value) else np.inf

    @property
    def n_determined(self) -> int:
        """Number of parameters whose relative standard deviation is at most 1."""
        return int((self.std <= 1).sum())

    @property
    def determined(self) -> bool:
        """True if the relative standard deviation of every parameter of interest is at most 1."""
        return self.worst_std <= 1


@dataclass(frozen=True, eq=False)
class SmallestTest:
    """Smallest test, by greedy choice, that reaches a wanted accuracy.

    Attributes
    ----------
    target : float
        Wanted relative standard deviation of the worst parameter of interest.
    sensors : PlannedTest or None
        The smallest set of sensors at all lines that reaches it; None where all of them do not.
    frequencies : PlannedTest or None
        The fewest lines for the chosen sensors and loads; None where all lines do not reach it.
    averages : float
        How many times as many averages the chosen test needs, since the noise falls with their root.
    """

    target: float
    sensors: PlannedTest | None
    frequencies: PlannedTest | None
    averages: float


@dataclass(frozen=True, eq=False, kw_only=True)
class PlannedTests:
    """The chosen test and the tests that it is compared with.

    Attributes
    ----------
    installed : PlannedTest or None
        What is there already.
    chosen : PlannedTest
        The best sensors and loads found, at all lines.
    kammer : PlannedTest or None
        As many sensors by effective independence of the mode shapes, under the same loads, where the structure has modes.
    everything : PlannedTest
        Every candidate at once.
    frequencies : PlannedTest or None
        `chosen` at the best lines, where a number of lines is asked for.
    spread : PlannedTest or None
        `chosen` at as many lines spread evenly over the candidate lines, for comparison.
    next_sensors : tuple of PlannedTest
        The installed (or else the chosen) test with one more sensor, the most telling first.
    """

    installed: PlannedTest | None
    chosen: PlannedTest
    kammer: PlannedTest | None
    everything: PlannedTest
    frequencies: PlannedTest | None
    spread: PlannedTest | None
    next_sensors: tuple[PlannedTest, ...]

    @property
    def determined(self) -> bool:
        """True if the test with all candidates gives every parameter of interest a relative standard deviation of at most 1."""
        return self.everything.determined

    @property
    def tests(self) -> tuple[PlannedTest, ...]:
        """Every test to compare, in the order of a table."""
        following = self.next_sensors[:1]
        tests = (self.installed, *following, self.chosen, self.kammer, self.everything, self.frequencies, self.spread)
        return tuple(test for test in tests if test is not None)


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan(PlannedTests):
    """A planned test beside its alternatives, which are documented as `PlannedTests`.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
    options : PlanOptions
        With the candidates filled in.
    enough : SmallestTest or None
    identifiability : Identifiability
        Rank, undetermined directions and collinear groups of the chosen test, from its data alone.
    assumption : str
        The tolerances that `PlannedTest.of_tolerances` are owed to, in words; "" where all that is held is taken as exact.
    """

    structure: Structure
    parameters: Parameters
    options: PlanOptions
    enough: SmallestTest | None
    identifiability: Identifiability
    assumption: str = ""

    @property
    def is_undamped(self) -> bool:
        """True if the model at the initial values has no damping, so that its resonances are infinitely high.

        Always False for a structure without matrices.
        """
        if not self.structure.has_matrices:
            return False
        values = self.parameters.values(self.parameters.start)
        return not any(
            self.structure.matrix(matrix_kind, values).count_nonzero()
            for matrix_kind in ("damping", "structural_damping")
        )

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the parameters of interest that the test with all candidates leaves with a relative deviation above 1."""
        lost = ~(self.everything.std <= 1) & self.everything.of_interest
        return tuple(name for name, is_lost in zip(self.parameters.names, lost, strict=True) if is_lost)
