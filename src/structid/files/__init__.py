"""Files: read with a clear word when something is wrong with them, and written whole or not at all."""

from structid.files.reading import DAMAGE, damage_told, digest, read_part, read_start, require_readable
from structid.files.writing import (
    atomic_write,
    claim,
    claim_path,
    csv_text,
    make_folder,
    release,
    replace_unchanged,
    require_no_file,
)

__all__ = [
    "DAMAGE",
    "atomic_write",
    "claim",
    "claim_path",
    "csv_text",
    "damage_told",
    "digest",
    "make_folder",
    "read_part",
    "read_start",
    "release",
    "replace_unchanged",
    "require_no_file",
    "require_readable",
]
