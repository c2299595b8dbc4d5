"""Estimators: they see a problem through its protocol only, and give an `Estimate`."""

from structid.estimation.block_least_squares import BlockFit, block_solution
from structid.estimation.bootstrap import Bootstrap, bootstrap, bootstrap_repeats
from structid.estimation.estimate import Estimate, Status, estimate
from structid.estimation.identifiability import Direction, Identifiability, identifiability
from structid.estimation.intervals import Intervals, intervals
from structid.estimation.joint_problem import JointProblem, stage_plans, thinned
from structid.estimation.least_squares import GaussNewton, LevenbergMarquardt, Minimum, minimize
from structid.estimation.local_reduction import Kernels
from structid.estimation.many_small import solutions_of_many
from structid.estimation.multistart import Answer
from structid.estimation.problem import Linearization, Problem, parameter_sizes
from structid.estimation.profile import Profile, profile, profiles
from structid.estimation.residual_tests import ResidualTests, residual_tests
from structid.estimation.sampling import Samples, sample, to_arviz
from structid.estimation.streaming_qr import LinearFit, StreamingQr, no_rows

__all__ = [
    "Answer",
    "BlockFit",
    "Bootstrap",
    "Direction",
    "Estimate",
    "GaussNewton",
    "Identifiability",
    "Intervals",
    "JointProblem",
    "Kernels",
    "LevenbergMarquardt",
    "LinearFit",
    "Linearization",
    "Minimum",
    "Problem",
    "Profile",
    "ResidualTests",
    "Samples",
    "Status",
    "StreamingQr",
    "block_solution",
    "bootstrap",
    "bootstrap_repeats",
    "estimate",
    "identifiability",
    "intervals",
    "minimize",
    "no_rows",
    "parameter_sizes",
    "profile",
    "profiles",
    "residual_tests",
    "sample",
    "solutions_of_many",
    "stage_plans",
    "thinned",
    "to_arviz",
]
