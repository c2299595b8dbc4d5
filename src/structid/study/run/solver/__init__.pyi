"""The public names, each with its place; `structid.lazy` reads them from here."""

from structid.study.run.solver.rounds import relinearize_solver as relinearize_solver
from structid.study.run.solver.rounds import with_nominal_start as with_nominal_start
from structid.study.run.solver.rounds import with_solver as with_solver
