"""All arrays of a result as one HDF5 file, and the values of the parameters read from it."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from structid.core.errors import FileError
from structid.dynamics import Modes
from structid.fem import Structure
from structid.identification.record_fit import RecordFit
from structid.inversion import Estimate
from structid.study.results.result import StudyResult

if TYPE_CHECKING:
    import h5py

    from structid.files.contained import Field
    from structid.identification.modal_fit import ModalFit

#: What a file of this version says of itself.
ESTIMATE_FORMAT = "structid estimate 1"


def hdf5_bytes(result: StudyResult) -> bytes:
    """Content of the file estimate.h5.

    It is made in memory, so that a full disk shows as an ordinary error when the bytes are written. Groups are
    ``parameters``, ``frf``, ``evaluation``, ``modes`` and ``modes_initial``; the last four are of the first record of
    responses, and repeated in ``record_2``, ``record_3`` and so on for further ones. Records of modes are in
    ``modal_record_1`` and so on. Without a record of responses, ``frf`` and ``evaluation`` are left out. Units are
    attributes. ``subdivide`` is the number of pieces into which each beam was cut. With very many parameters, posterior
    draws stand in place of covariance matrices.
    """
    import h5py  # so that `import structid` stays light

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", track_order=True) as file:
        file.attrs["format"] = ESTIMATE_FORMAT
        file.attrs["structid"] = result.provenance.structid
        file.attrs["title"] = result.study.title
        _put(file, "subdivide", [result.study.structure.subdivide], "1")
        identification = result.identification
        _write_parameters(file.create_group("parameters"), identification.estimate)
        if identification.fits:
            _write_record(file, identification.fits[0])
        else:
            _write_modes(file.create_group("modes"), identification.modes, identification.structure)
            _write_modes(file.create_group("modes_initial"), identification.modes_initial, identification.structure)
        for number, fit in enumerate(identification.modal_fits, 1):
            _write_modal(file.create_group(f"modal_record_{number}"), fit)
        for number, further in enumerate(identification.fits[1:], 2):
            group = file.create_group(f"record_{number}", track_order=True)
            group.attrs["name"] = further.name
            _write_record(group, further)
    return buffer.getvalue()


def _write_record(group: h5py.Group, fit: RecordFit) -> None:
    """Write the groups ``frf``, ``evaluation``, ``modes`` and ``modes_initial`` of one record of responses into `group`."""
    _write_frf(group.create_group("frf"), fit)
    _write_evaluation(group.create_group("evaluation"), fit)
    _write_modes(group.create_group("modes"), fit.modes, fit.problem.structure)
    _write_modes(group.create_group("modes_initial"), fit.modes_initial, fit.problem.structure)


def _put(group: h5py.Group, name: str, values: ArrayLike, unit: str = "") -> None:
    """Write one array as the dataset `name`, with its unit, if not "", as the attribute ``unit``."""
    array = np.asarray(values)
    dataset = group.create_dataset(name, data=array, track_times=False)
    if unit:
        dataset.attrs["unit"] = unit


def _texts(group: h5py.Group, name: str, values: Iterable[object]) -> None:
    """Write `values`, turned into texts, as the dataset `name` of byte strings of one length."""
    group.create_dataset(name, data=np.array([str(value).encode() for value in values], dtype="S"), track_times=False)


def _write_parameters(group: h5py.Group, estimate: Estimate) -> None:
    """Write an estimate into `group`: names, kinds, units, values, deviations, identifiability and search history.

    Covariances (n_params, n_params) are written where the estimate has them, else posterior draws (n_draws, n_params).
    """
    _texts(group, "names", estimate.names)
    _texts(group, "kinds", estimate.kinds)
    _texts(group, "units", estimate.units)
    note = "as in units, one a parameter"
    _put(group, "initial", estimate.initial, note)
    _put(group, "values", estimate.values, note)
    _put(group, "std", estimate.std, note)
    if estimate.uncertainty.has_matrix:
        _texts(group, "covariance_basis", [estimate.covariance_basis])
        _put(group, "covariance_noise", estimate.spread.covariance_noise, "products of units")
        _put(group, "covariance_model_error", estimate.spread.covariance_model_error, "products of units")
        _put(group, "correlation", estimate.spread.correlation, "1")
        if estimate.fixed is not None:
            _texts(group, "fixed_names", estimate.fixed.change_names)
            _put(group, "fixed_tolerances", estimate.fixed.error, "1")
            _put(group, "fixed_changes", estimate.fixed.changes, "as in units, by one tolerance of each fixed value")
    else:
        _put(group, "std_relative_error", estimate.uncertainty.std_error, "1")
        _put(group, "draws", estimate.uncertainty.draws, note)
    group.attrs["covariance_basis"] = estimate.covariance_basis
    _put(group, "identified", estimate.identified)
    _put(group, "singular_values", estimate.identifiability.singular_values, "1")
    directions = [item.vector for item in estimate.identifiability.directions]
    _put(group, "unidentifiable_directions", np.array(directions).reshape(len(directions), len(estimate.names)), "1")
    _put(group, "history", estimate.search.history, note)
    if estimate.search.stages:
        _texts(group, "stages", [stage.name for stage in estimate.search.stages])
        for k, stage in enumerate(estimate.search.stages):
            _put(group, f"stage_{k}_history", stage.history, note)
            _put(group, f"stage_{k}_sum_of_squares", stage.costs, "1")


def _write_frf(group: h5py.Group, fit: RecordFit) -> None:
    """Write the FRFs that were fitted into `group`: measured, predicted, residual (predicted minus measured) and noise.

    The arrays are (n_lines, n_outputs, n_inputs); variance, coherence and decay are written where the record has them.
    """
    record = fit.problem.record
    group.attrs["kind"] = record.kind
    group.attrs["noise_source"] = record.noise_source
    _texts(group, "kind", [record.kind])
    _texts(group, "outputs", record.outputs)
    _texts(group, "inputs", record.inputs)
    _put(group, "frequency", record.frequency, "Hz")
    if record.decay is not None:
        _put(group, "decay", record.decay, "1/s")
    _put(group, "measured", record.values, record.unit)
    _put(group, "predicted", fit.predicted, record.unit)
    _put(group, "predicted_initial", fit.predicted_initial, record.unit)
    _put(group, "residual", fit.predicted - record.values, record.unit)
    if record.variance is not None:
        _put(group, "variance", record.variance, f"({record.unit})^2")
    if record.coherence is not None:
        _put(group, "coherence", record.coherence, "1")


def _write_evaluation(group: h5py.Group, fit: RecordFit) -> None:
    """Write measured and predicted FRFs, and the relative error of the prediction, on the lines that judge the fit.

    FRFs of the fitted and of the initial model are (n_lines, n_outputs, n_inputs); there may be more lines than were
    fitted.
    """
    unit = fit.evaluation.unit
    _put(group, "frequency", fit.evaluation.frequency, "Hz")
    _put(group, "measured", fit.evaluation.values, unit)
    _put(group, "predicted", fit.evaluation_predicted, unit)
    _put(group, "predicted_initial", fit.evaluation_initial, unit)
    _put(group, "relative_error", fit.relative_error, "1")


def _write_modal(group: h5py.Group, fit: ModalFit) -> None:
    """Write measured modes of a record into `group`, and frequency, damping ratio and MAC of the paired model modes.

    The pairs are written twice, with the names ``..._initial`` and ``..._fitted`` for the initial and the fitted model.
    """
    measured = fit.measured
    group.attrs["name"], group.attrs["source"] = fit.name, measured.source
    _texts(group, "channels", measured.channels)
    _put(group, "frequency", measured.frequency, "Hz")
    _put(group, "damping_ratio", measured.damping_ratio, "1")
    _put(group, "mode_shapes", measured.mode_shapes)
    if measured.covariance is not None:
        _put(group, "covariance", measured.covariance, "products of Hz and 1")
    for name, pairs in (("initial", fit.initial), ("fitted", fit.fitted)):
        _put(group, f"frequency_{name}", pairs.frequency, "Hz")
        _put(group, f"damping_ratio_{name}", pairs.damping_ratio, "1")
        _put(group, f"mac_{name}", pairs.mac, "1")


def _write_modes(group: h5py.Group, modes: Modes, structure: Structure) -> None:
    """Write the modes of the model into `group`: degrees of freedom, frequencies (Hz), damping ratios and shapes.

    The shapes (n_dofs, n_modes) have unit modal mass, 1/sqrt(kg); their rows are the free degrees of freedom of
    `structure`.
    """
    _texts(group, "dofs", structure.dofs)
    _put(group, "frequency", modes.frequency, "Hz")
    _put(group, "damping_ratio", modes.damping_ratio, "1")
    _put(group, "mode_shapes", modes.mode_shapes, "1/sqrt(kg)")


class StoredParameters(NamedTuple):
    """Identified values of the parameters by name, SI units, and the number of pieces of each beam, None if unknown."""

    values: dict[str, float]
    folder: Path
    stored_pieces: Field | None

    @property
    def pieces(self) -> int:
        """Number of pieces into which each beam was cut; `FileError` if the results folder does not say it."""
        return number_of_pieces(self.stored_pieces, self.folder)


def stored_parameters(folder: Path) -> StoredParameters:
    """Identified values by parameter name, and number of pieces of each beam, from the estimate.h5 of a results folder.

    A number of pieces that the file lacks is an error only when it is asked for.

    Raises
    ------
    FileError
        If there is no estimate.h5, or its parameters are missing, damaged or not finite.
    """
    path = folder / "estimate.h5"
    fields = _stored_fields(folder, ("parameters/names", "parameters/values", "subdivide"))
    from structid.files.contained import texts_of  # writing needs no reader

    try:
        names = texts_of(fields["parameters/names"])
        values = np.asarray(fields["parameters/values"], dtype=float)
    except (KeyError, ValueError) as error:
        raise FileError(f"{path}: holds no parameters; write it again with `structid identify`") from error
    if values.shape != (len(names),) or not np.isfinite(values).all():
        raise FileError(f"{path}: its parameters cannot be used; write it again with `structid identify`")
    return StoredParameters(dict(zip(names, values.tolist(), strict=True)), folder, fields.get("subdivide"))


def stored_pieces(folder: Path) -> int:
    """Number of pieces into which each beam was cut at the identification, from the file estimate.h5 of a results folder.

    Raises
    ------
    FileError
        If there is no estimate.h5, or it does not say the number.
    """
    return number_of_pieces(_stored_fields(folder, ("subdivide",)).get("subdivide"), folder)


def number_of_pieces(count: Field | None, folder: Path) -> int:
    """Number of pieces of each beam, from the dataset ``subdivide`` of estimate.h5; `FileError` if it is None."""
    if count is None:
        raise FileError(f"{folder}: does not say into how many pieces its beams were cut; identify again")
    return int(np.asarray(count).ravel()[0])


def _stored_fields(folder: Path, names: Sequence[str]) -> dict[str, Field]:
    """Datasets `names` of the file estimate.h5 of a results folder, by name; those that it lacks are left out.

    `FileError` if there is no such file.
    """
    path = folder / "estimate.h5"
    if not path.is_file():
        raise FileError(f"{folder}: holds no estimate.h5; give a results folder of `structid identify`")
    from structid.files.contained import hdf5_fields  # writing needs no reader

    return hdf5_fields(path, names)
