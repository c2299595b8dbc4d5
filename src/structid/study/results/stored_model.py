"""The identified model of a results folder, for predictions from it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import cast

import numpy as np

from structid.core.errors import FileError, InputError, NoAnswerError
from structid.core.units import FrfKind
from structid.files import require_readable
from structid.files.hdf5 import hdf5_datasets, hdf5_fields, texts_of
from structid.inversion.fixed_values import SECOND_ORDER
from structid.prediction.identified_model import IdentifiedModel, identified_model
from structid.prediction.model_error import ModelError
from structid.study.results.folder import STUDY_PATH
from structid.study.schema.study import Study, load_study

_ARRAYS = ("names", "values", "covariance_basis", "covariance_noise", "covariance_model_error")
_FIXED = ("fixed_names", "fixed_tolerances", "fixed_changes")
_ERROR = ("frequency", "model_error_part", "model_error_size", "model_error_kind")
_AGAIN = "identify again with this version of structid"


def stored_study(folder: Path, study: Path | None = None) -> Study:
    """The study of a results folder, read from where it was identified, or from the file `study`.

    Raises
    ------
    FileError
        If there is no such folder, or its study is no longer where it was or is no longer the same.
    """
    place = folder / "estimate.json"
    if not place.is_file():
        raise FileError(f"{folder}: holds no estimate.json; give a results folder of `structid identify`")
    try:
        told = json.loads(require_readable(place).read_text(encoding="utf-8"))
        way, inputs = _text(folder / STUDY_PATH).strip(), dict(told["provenance"]["inputs"])
    except (ValueError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise FileError(f"{place}: does not say which study it is of; {_AGAIN}") from error
    path = study or folder / way
    if not path.is_file():
        raise FileError(f"{folder}: its study is no longer at {path}; say where it is with --study")
    found = load_study(path)
    changed = [name for name, digest in found.digests.items() if inputs.get(name, digest) != digest]
    if found.text != _text(folder / "study.toml") or changed:
        what = listed[0] if (listed := [name for name in changed if name != path.name]) else path.name
        raise FileError(
            f"{path}: {what} has changed since {folder} was identified; identify again, or give the study as it was with --study"
        )
    return found


def _text(path: Path) -> str:
    return require_readable(path).read_bytes().decode("utf-8", errors="replace")


def stored_model(folder: Path, study: Study) -> tuple[IdentifiedModel, ModelError | None]:
    """The identified model of the results folder of a study, and what its fit missed beyond noise where it did.

    Raises
    ------
    FileError
        If the folder's estimate.h5 is missing, damaged, of another study or of another version.
    NoAnswerError
        If the data do not determine the model, or the search gave no covariance.
    """
    path = folder / "estimate.h5"
    present = set(hdf5_datasets(require_readable(path)))
    names = [f"parameters/{name}" for name in (*_ARRAYS, *_FIXED) if f"parameters/{name}" in present]
    names += [f"frf/{name}" for name in _ERROR if f"frf/{name}" in present]
    stored = {name.removeprefix("parameters/"): value for name, value in hdf5_fields(path, names).items()}
    if "covariance_noise" not in stored and "parameters/draws" in present:
        raise NoAnswerError(
            f"{path}: holds no covariance, which a search without matrices does not give; group the unknowns and identify again"
        )
    missing = [name for name in _ARRAYS if name not in stored]
    if missing:
        raise FileError(f"{path}: holds no {missing[0]}; {_AGAIN}")
    known, parameters = list(texts_of(stored["names"])), study.parameters
    absent = [name for name in parameters.names if name not in known]
    if absent:
        raise FileError(f"{path}: has no parameter {absent[0]} of the study {study.path}; {_AGAIN}")
    index = [known.index(name) for name in parameters.names]
    is_doubted = texts_of(stored["covariance_basis"])[0] == "model_error"
    covariance = np.asarray(stored["covariance_model_error" if is_doubted else "covariance_noise"], dtype=float)
    fixed, changes, words = None, None, "± takes what the model holds as exact"
    if all(name in stored for name in _FIXED):
        names = [name for name in texts_of(stored["fixed_names"]) if name != SECOND_ORDER]
        fixed = dict(zip(names, np.asarray(stored["fixed_tolerances"], dtype=float).tolist(), strict=True))
        changes = np.asarray(stored["fixed_changes"], dtype=float)[index, : len(names)]
        words = "± includes the tolerances of fixed values"
    model = identified_model(
        study.structure,
        parameters,
        np.asarray(stored["values"], dtype=float)[index],
        covariance[np.ix_(index, index)],
        fixed,
        changes,
        words,
    )
    if "frf/model_error_part" not in stored:
        if is_doubted and "frf/frequency" in stored:
            raise FileError(f"{path}: does not say what the fit missed at a sensor left out; {_AGAIN}")
        return model, None
    frequency, part, size = (np.asarray(stored[f"frf/{name}"], dtype=float) for name in _ERROR[:3])
    kind = cast(FrfKind, texts_of(stored["frf/model_error_kind"])[0])
    return model, ModelError(frequency, part, size, kind)


def stored_loads(folder: Path) -> tuple[str, ...]:
    """Degrees of freedom at which forces acted in the record that a results folder is of.

    Raises
    ------
    InputError
        If the record was of modes, which have no loads.
    """
    path = folder / "estimate.h5"
    if "frf/inputs" not in hdf5_datasets(require_readable(path)):
        raise InputError(f"`loads` must say where forces act: the record behind {folder} has none", "loads")
    return texts_of(hdf5_fields(path, ["frf/inputs"])["frf/inputs"])
