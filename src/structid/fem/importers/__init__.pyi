"""The public names, each with its place; `structid.lazy` reads them from here."""

from structid.fem.importers.checks import group_from_exports as group_from_exports
from structid.fem.importers.checks import in_si as in_si
from structid.fem.importers.checks import require_semidefinite as require_semidefinite
from structid.fem.importers.checks import require_total_mass as require_total_mass
from structid.fem.importers.checks import total_mass as total_mass
from structid.fem.importers.imported import ElementEntries as ElementEntries
from structid.fem.importers.imported import ImportedMatrix as ImportedMatrix
from structid.fem.importers.imported import codes_of as codes_of
from structid.fem.importers.imported import complete_triangles as complete_triangles
from structid.fem.importers.imported import dof_table as dof_table
from structid.fem.importers.imported import dofs_of as dofs_of
from structid.fem.importers.imported import of_elements as of_elements
from structid.fem.importers.imported import on_dofs as on_dofs
from structid.fem.importers.imported import tables_of as tables_of
from structid.fem.importers.matrix_files import FORMATS as FORMATS
from structid.fem.importers.matrix_files import Op4Options as Op4Options
from structid.fem.importers.matrix_files import read_matrices as read_matrices
from structid.fem.importers.matrix_files import read_matrix as read_matrix
from structid.fem.importers.matrix_files import write_abaqus as write_abaqus
from structid.fem.importers.matrix_files import write_dmig as write_dmig
from structid.fem.importers.matrix_files import write_matrices as write_matrices
from structid.fem.importers.matrix_files import write_matrix as write_matrix
from structid.fem.importers.matrix_files import write_op4 as write_op4
from structid.fem.importers.numbering import read_numbering as read_numbering
from structid.fem.importers.numbering import write_numbering as write_numbering
