"""The public names, each with its place; `structid.lazy` reads them from here."""

from structid.study.run.solver.rounds import about_answer as about_answer
from structid.study.run.solver.rounds import from_nominal as from_nominal
from structid.study.run.solver.rounds import with_solver as with_solver
