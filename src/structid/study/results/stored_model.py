"""The identified model of a results folder, for predictions from it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import parse_dofs
from structid.core.errors import FileError, InputError, NoAnswerError
from structid.core.units import FrfKind
from structid.files import require_readable
from structid.files.contained import Field, hdf5_attributes, hdf5_fields, texts_of
from structid.prediction.identified_model import IdentifiedModel, identified_model
from structid.prediction.model_error import ModelError
from structid.records import FrfRecord
from structid.study.results.folder import STUDY_PATH
from structid.study.results.hdf5 import ESTIMATE_FORMAT, stored_pieces
from structid.study.results.result import UPDATED
from structid.study.schema.study import Study, cut_study, load_study

_ARRAYS = ("names", "values", "covariance_basis", "covariance_noise", "covariance_model_error")
_FIXED = ("fixed_names", "fixed_tolerances", "fixed_changes")
_FITTED = ("kind", "outputs", "inputs", "frequency", "measured", "predicted")
_AGAIN = "identify again with this version of structid"


def stored_study(folder: Path, study: Path | None = None) -> Study:
    """The study of a results folder, read from its stored path or from the file `study`, and checked to be unchanged.

    Beams are cut into as many pieces as in the identification.

    Raises
    ------
    FileError
        If the folder or its study file is missing, or the study or one of its input files has changed since.
    InputError
        If a solver gives the model of the study.
    """
    summary = folder / "estimate.json"
    if not summary.is_file():
        raise FileError(f"{folder}: holds no estimate.json; give a results folder of `structid identify`")
    try:
        stored = json.loads(require_readable(summary).read_text(encoding="utf-8"))
        relative, inputs = _text(folder / STUDY_PATH).strip(), dict(stored["provenance"]["inputs"])
    except (ValueError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise FileError(f"{summary}: does not say which study it is of; {_AGAIN}") from error
    path = study or folder / relative
    if not path.is_file():
        raise FileError(f"{folder}: its study is no longer at {path}; say where it is with --study")
    read = load_study(path)
    changed = [name for name, digest in read.digests.items() if inputs.get(name, digest) != digest]
    if read.text != _text(folder / "study.toml") or changed:
        what = listed[0] if (listed := [name for name in changed if name != path.name]) else path.name
        raise FileError(
            f"{path}: {what} has changed since {folder} was identified; identify again, or give the study as it was with --study"
        )
    if read.solved is not None:
        raise InputError(
            f"{path}: its model comes from a solver, and a results folder does not hold the one at the answer; its deck with the"
            f" identified numbers is in {folder / UPDATED}, and predictions are made in Python from the identification itself"
        )
    return cut_study(read, stored_pieces(folder)) if read.leaves_pieces_open else read


def stored_doubt(folder: Path) -> str:
    """A sentence of warning if the identified model of a results folder does not explain its record; else ""."""
    verdict = json.loads(require_readable(folder / "estimate.json").read_text(encoding="utf-8")).get("verdict")
    if verdict != "wrong_model":
        return ""
    return (
        "the verdict on this model is that it does not explain its record, so that bands from it may miss the truth; see the causes"
        f" in {folder}, mend the model and identify again"
    )


def _text(path: Path) -> str:
    return require_readable(path).read_bytes().decode("utf-8", errors="replace")


def stored_model(folder: Path, study: Study) -> IdentifiedModel:
    """The identified model of the results folder `folder`, for the study `study` that belongs to it.

    It has the values, their covariance on the basis of the estimate, and the effect of the tolerances of fixed values
    if stored.

    Raises
    ------
    FileError
        If the folder's estimate.h5 is missing, damaged, of another study or of another version.
    NoAnswerError
        If the data do not determine the model.
    InputError
        If the search gave no covariance.
    """
    path = folder / "estimate.h5"
    form = hdf5_attributes(require_readable(path)).get("@format", ("none",))[0]
    if form != ESTIMATE_FORMAT:
        raise FileError(f"{path}: is of another version of structid ({form}, not {ESTIMATE_FORMAT}); {_AGAIN}")
    stored = _read_group(path, "parameters", (*_ARRAYS, *_FIXED, "draws"))
    if "covariance_noise" not in stored and "draws" in stored:
        raise InputError(
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
    covariance = np.asarray(stored[f"covariance_{texts_of(stored['covariance_basis'])[0]}"], dtype=float)
    fixed, changes, words = None, None, "± takes what the model holds as exact"
    if all(name in stored for name in _FIXED):
        tolerances = np.append(np.asarray(stored["fixed_tolerances"], dtype=float), 0.0)  # the second order is last
        fixed = dict(zip(texts_of(stored["fixed_names"]), tolerances.tolist(), strict=True))
        changes = np.asarray(stored["fixed_changes"], dtype=float)[index]
        words = "± includes the tolerances of fixed values"
    values, spread = np.asarray(stored["values"], dtype=float)[index], covariance[np.ix_(index, index)]
    try:
        return identified_model(study.structure, parameters, values, spread, fixed, changes, words)
    except NoAnswerError as error:
        raise NoAnswerError(f"{folder}: {error}") from error


@dataclass(frozen=True, eq=False)
class ParameterSpread:
    """The parameters of a study before identification, and how uncertain they are after it.

    Attributes
    ----------
    initial : (n_parameters,) float array
    covariance : (n_parameters, n_parameters) float array
        By data and by the tolerances of fixed values, as the stated deviations.
    """

    initial: FloatArray
    covariance: FloatArray


def stored_spread(folder: Path, study: Study) -> ParameterSpread:
    """Initial values (n_params,) and covariance (n_params, n_params) of the parameters, from a results folder.

    They are in the order of the study's parameters. The covariance includes the tolerances of fixed values.

    Raises
    ------
    FileError
        If the folder's estimate.h5 holds no initial values.
    """
    path = folder / "estimate.h5"
    stored = _read_group(path, "parameters", (*_ARRAYS, "initial", "fixed_changes"))
    if "initial" not in stored:
        raise FileError(f"{path}: holds no initial values; {_AGAIN}")
    names = list(texts_of(stored["names"]))
    index = [names.index(name) for name in study.parameters.names]
    covariance = np.asarray(stored[f"covariance_{texts_of(stored['covariance_basis'])[0]}"], dtype=float)
    changes = np.asarray(stored.get("fixed_changes", np.zeros((len(names), 0))), dtype=float)
    spread = covariance + changes @ changes.T
    return ParameterSpread(np.asarray(stored["initial"], dtype=float)[index], spread[np.ix_(index, index)])


def stored_model_error(folder: Path, study: Study) -> ModelError | None:
    """Model error of predictions: the error of the fitted FRFs at each sensor when it is left out of the fit.

    The FRFs and identified values are those of the results folder `folder` of `study`; of several records, the first
    that is none of modes counts. None where the fit reaches the noise, and where no FRFs were fitted.

    Raises
    ------
    FileError
        If the folder's estimate.h5 holds FRFs but not all that belongs to them.
    """
    path = folder / "estimate.h5"
    identified = _read_group(path, "parameters", ("names", "values", "covariance_basis"))
    basis = texts_of(identified["covariance_basis"])[0]
    stored = _read_group(path, "frf", (*_FITTED, "variance", "decay"))
    if basis != "model_error" or "frequency" not in stored:
        return None
    missing = [name for name in _FITTED if name not in stored]
    if missing:
        raise FileError(f"{path}: does not say the {missing[0]} of its FRFs; {_AGAIN}")
    record = FrfRecord(
        np.asarray(stored["frequency"], dtype=float),
        np.asarray(stored["measured"], dtype=complex),
        parse_dofs(texts_of(stored["outputs"])),
        parse_dofs(texts_of(stored["inputs"])),
        cast(FrfKind, texts_of(stored["kind"])[0]),
        variance=_floats(stored.get("variance")),
        decay=_floats(stored.get("decay")),
    )
    source = next(source for source in study.setups if source.record.modes is None)
    value_of = dict(zip(texts_of(identified["names"]), np.asarray(identified["values"], dtype=float), strict=True))
    physical = np.array([value_of[name] for name in source.parameters.names])
    predicted = np.asarray(stored["predicted"], dtype=complex)
    return ModelError.of_fit(source.structure, source.parameters, physical, record, predicted)


def _floats(field: Field | None) -> FloatArray | None:
    return None if field is None else np.asarray(field, dtype=float)


def _read_group(path: Path, group: str, names: tuple[str, ...]) -> dict[str, Field]:
    """The datasets `names` of a group in an HDF5 file, by name; those that the file lacks are left out.

    The group "" is the whole file.
    """
    places = {f"{group}/{name}".removeprefix("/"): name for name in names}
    return {places[path_in_file]: field for path_in_file, field in hdf5_fields(path, places).items()}


def stored_band(folder: Path) -> tuple[float, float] | None:
    """Lowest and highest frequency above 0, Hz, of the fitted FRFs of a results folder; None if it has none."""
    stored = _read_group(folder / "estimate.h5", "frf", ("frequency",))
    if "frequency" not in stored:
        return None
    frequency = np.asarray(stored["frequency"], dtype=float)
    positive = frequency[frequency > 0]
    return (float(positive.min()), float(positive.max())) if len(positive) else None


def stored_loads(folder: Path, is_needed: bool = True) -> tuple[str, ...]:
    """Degrees of freedom, as text, at which forces acted in the fitted FRFs of a results folder; () if it has no FRFs.

    Raises
    ------
    InputError
        If it has no fitted FRFs, as with a record of modes, and `is_needed` is True.
    """
    stored = _read_group(folder / "estimate.h5", "frf", ("inputs",))
    if not stored and not is_needed:
        return ()
    if not stored:
        raise InputError(f"`loads` must say where forces act: the record behind {folder} has none", "loads")
    return texts_of(stored["inputs"])
