"""The names that a study's structure is read by, each with its place; `structid.lazy` reads them from here."""

from structid.study.schema.model.matrices import GROUP as GROUP
from structid.study.schema.model.matrices import MATRICES as MATRICES
from structid.study.schema.model.matrices import MEASURED as MEASURED
from structid.study.schema.model.matrices import NUMBERING as NUMBERING
from structid.study.schema.model.matrices import read_groups as read_groups
from structid.study.schema.model.matrices import read_measured as read_measured
from structid.study.schema.model.mesh import MESH as MESH
from structid.study.schema.model.mesh import SUPPORT as SUPPORT
from structid.study.schema.model.mesh import group_table as group_table
from structid.study.schema.model.mesh import read_points as read_points
from structid.study.schema.model.mesh import read_structure_mesh as read_structure_mesh
from structid.study.schema.model.mesh import read_supports as read_supports
from structid.study.schema.model.mesh import require_all_assigned as require_all_assigned
from structid.study.schema.model.mesh import take_parts as take_parts
from structid.study.schema.model.solver import SOLVER as SOLVER
from structid.study.schema.model.solver import positions_of as positions_of
from structid.study.schema.model.solver import read_solver as read_solver
