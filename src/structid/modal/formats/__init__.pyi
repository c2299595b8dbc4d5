"""The public names, each with its place; `structid.lazy` reads them from here."""

from structid.modal.formats.files import modal_fields as modal_fields
from structid.modal.formats.files import read_modes as read_modes
from structid.modal.formats.files import write_modes as write_modes
from structid.modal.formats.options import ModeFileOptions as ModeFileOptions
