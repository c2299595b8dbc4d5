"""The public names, each with its place; `structid.lazy` reads them from here.

The function `estimate` has the name of its module: it is `structid.estimate`.
"""

from structid.inversion.composed_problems import JointProblem as JointProblem
from structid.inversion.diagnostics.identifiability import Direction as Direction
from structid.inversion.diagnostics.identifiability import Identifiability as Identifiability
from structid.inversion.diagnostics.identifiability import identifiability as identifiability
from structid.inversion.diagnostics.residual_tests import ResidualTests as ResidualTests
from structid.inversion.diagnostics.residual_tests import residual_tests as residual_tests
from structid.inversion.estimate import Estimate as Estimate
from structid.inversion.estimate import Status as Status
from structid.inversion.intervals import Intervals as Intervals
from structid.inversion.intervals import parameter_intervals as parameter_intervals
from structid.inversion.intervals import to_arviz as to_arviz
from structid.inversion.intervals.bootstrap import Bootstrap as Bootstrap
from structid.inversion.intervals.bootstrap import bootstrap as bootstrap
from structid.inversion.intervals.bootstrap import bootstrap_repeats as bootstrap_repeats
from structid.inversion.intervals.profile import Profile as Profile
from structid.inversion.intervals.profile import profile as profile
from structid.inversion.intervals.profile import profiles as profiles
from structid.inversion.intervals.sampling import Samples as Samples
from structid.inversion.intervals.sampling import sample as sample
from structid.inversion.linearization import Linearization as Linearization
from structid.inversion.linearization import OperatorLinearization as OperatorLinearization
from structid.inversion.problem import DataRows as DataRows
from structid.inversion.problem import FreeUnknowns as FreeUnknowns
from structid.inversion.problem import Problem as Problem
from structid.inversion.search.least_squares import Method as Method
from structid.inversion.search.least_squares import Minimum as Minimum
from structid.inversion.search.least_squares import minimize as minimize
from structid.inversion.search.levenberg_marquardt import GaussNewton as GaussNewton
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt as LevenbergMarquardt
from structid.inversion.search.matrix_free import MatrixFree as MatrixFree
from structid.inversion.search.multistart import DistinctMinimum as DistinctMinimum
from structid.inversion.search.multistart import Search as Search
from structid.inversion.uncertainty import Covariance as Covariance
from structid.inversion.uncertainty import DenseCovariance as DenseCovariance
