"""Estimators: they see a problem through its protocol only, and give an `Estimate`."""

from structid.inversion.diagnostics.identifiability import Direction, Identifiability, identifiability
from structid.inversion.diagnostics.residual_tests import ResidualTests, residual_tests
from structid.inversion.estimate import Estimate, Status, estimate
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import DataRows, FreeUnknowns, Problem
from structid.inversion.problems.joint import JointProblem
from structid.inversion.search.least_squares import Method, minimize
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt
from structid.inversion.search.matrix_free import MatrixFree
from structid.inversion.search.minimum import Minimum
from structid.inversion.search.multistart import Answer, Search
from structid.inversion.uncertainty import Covariance, DenseCovariance

__all__ = [
    "Answer",
    "Covariance",
    "DataRows",
    "DenseCovariance",
    "Direction",
    "Estimate",
    "FreeUnknowns",
    "Identifiability",
    "JointProblem",
    "LevenbergMarquardt",
    "Linearization",
    "MatrixFree",
    "Method",
    "Minimum",
    "OperatorLinearization",
    "Problem",
    "ResidualTests",
    "Search",
    "Status",
    "estimate",
    "identifiability",
    "minimize",
    "residual_tests",
]
