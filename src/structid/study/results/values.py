"""Values of the parameters that a results folder holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.errors import FileError
from structid.files.hdf5 import hdf5_fields, texts_of


def stored_values(folder: Path) -> dict[str, float]:
    """Identified value of each parameter, by name, in a results folder of `structid identify`.

    Raises
    ------
    FileError
        If there is no estimate.h5, or it is none of structid's.
    """
    path = folder / "estimate.h5"
    if not path.is_file():
        raise FileError(f"{folder}: holds no estimate.h5; give a results folder of `structid identify`")
    fields = hdf5_fields(path, ("parameters/names", "parameters/values"))
    try:
        names, values = fields["parameters/names"], np.asarray(fields["parameters/values"], dtype=float)
    except (KeyError, ValueError) as error:
        raise FileError(f"{path}: holds no parameters; write it again with `structid identify`") from error
    words = texts_of(names)
    if values.shape != (len(words),) or not np.isfinite(values).all():
        raise FileError(f"{path}: its parameters cannot be used; write it again with `structid identify`")
    return dict(zip(words, values.tolist(), strict=True))
