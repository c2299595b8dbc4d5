"""What others use of the package, each with its place; `structid.lazy` reads them from here."""

from structid.external.frf_model import FrfsOut as FrfsOut
from structid.external.frf_model import solved_frfs as solved_frfs
from structid.external.matrices_model import solved_matrices as solved_matrices
from structid.external.modes_model import solved_modes as solved_modes
from structid.external.outputs import MatricesOut as MatricesOut
from structid.external.outputs import ModesOut as ModesOut
from structid.external.runs import Solver as Solver
from structid.external.solved import SolvedModel as SolvedModel
from structid.external.solved import Units as Units
