"""Estimators: they see a problem through its protocol only, and give an `Estimate`."""

from structid.estimation.diagnostics.identifiability import Direction, Identifiability, identifiability
from structid.estimation.diagnostics.residual_tests import ResidualTests, residual_tests
from structid.estimation.estimate import Estimate, Status, estimate
from structid.estimation.intervals.bootstrap import Bootstrap, bootstrap, bootstrap_repeats
from structid.estimation.intervals.intervals import Intervals, intervals
from structid.estimation.intervals.profile import Profile, profile, profiles
from structid.estimation.intervals.sampling import Samples, sample, to_arviz
from structid.estimation.problem import Linearization, Problem, parameter_sizes
from structid.estimation.problems.joint import JointProblem, stage_plans, thinned
from structid.estimation.search.least_squares import GaussNewton, LevenbergMarquardt, Minimum, minimize
from structid.estimation.search.multistart import Answer

__all__ = [
    "Answer",
    "Bootstrap",
    "Direction",
    "Estimate",
    "GaussNewton",
    "Identifiability",
    "Intervals",
    "JointProblem",
    "LevenbergMarquardt",
    "Linearization",
    "Minimum",
    "Problem",
    "Profile",
    "ResidualTests",
    "Samples",
    "Status",
    "bootstrap",
    "bootstrap_repeats",
    "estimate",
    "identifiability",
    "intervals",
    "minimize",
    "parameter_sizes",
    "profile",
    "profiles",
    "residual_tests",
    "sample",
    "stage_plans",
    "thinned",
    "to_arviz",
]
