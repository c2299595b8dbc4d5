"""Estimators: they see a problem through its protocol only, and give an `Estimate`."""

from structid.estimation.diagnostics.identifiability import Direction, Identifiability, identifiability
from structid.estimation.diagnostics.residual_tests import ResidualTests, residual_tests
from structid.estimation.estimate import Estimate, Status, estimate
from structid.estimation.intervals.bootstrap import Bootstrap, bootstrap, bootstrap_repeats
from structid.estimation.intervals.export import to_arviz
from structid.estimation.intervals.intervals import Intervals, intervals
from structid.estimation.intervals.profile import Profile, profile, profiles
from structid.estimation.intervals.sampling import Samples, sample
from structid.estimation.linearization import Linearization, OperatorLinearization
from structid.estimation.problem import BaseProblem, Problem
from structid.estimation.problems.joint import JointProblem
from structid.estimation.search.gauss_newton import GaussNewton
from structid.estimation.search.least_squares import Method, minimize
from structid.estimation.search.levenberg_marquardt import LevenbergMarquardt
from structid.estimation.search.matrix_free import MatrixFree
from structid.estimation.search.minimum import Minimum
from structid.estimation.search.multistart import Answer, Search
from structid.estimation.uncertainty import Covariance, DenseCovariance

__all__ = [
    "Answer",
    "BaseProblem",
    "Bootstrap",
    "Covariance",
    "DenseCovariance",
    "Direction",
    "Estimate",
    "GaussNewton",
    "Identifiability",
    "Intervals",
    "JointProblem",
    "LevenbergMarquardt",
    "Linearization",
    "MatrixFree",
    "Method",
    "Minimum",
    "OperatorLinearization",
    "Problem",
    "Profile",
    "ResidualTests",
    "Samples",
    "Search",
    "Status",
    "bootstrap",
    "bootstrap_repeats",
    "estimate",
    "identifiability",
    "intervals",
    "minimize",
    "profile",
    "profiles",
    "residual_tests",
    "sample",
    "to_arviz",
]
