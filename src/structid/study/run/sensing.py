"""`structid sense`: the motion that a record tells of places without a sensor, by the model of a results folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from structid.core.constraints import split_commas
from structid.core.errors import InputError
from structid.core.json_types import StoredEntry
from structid.files import csv_text
from structid.prediction.options import SenseOptions
from structid.prediction.recovery import distinct_channels, output_unit, parse_outputs
from structid.prediction.sensing.sense import SensedMotion, sense
from structid.prediction.sensing.state_equations import UnknownForces
from structid.records import ReadOptions, TimeRecord, read_record
from structid.records.record import QUANTITY_UNITS
from structid.study.results.stored_model import stored_doubt, stored_model, stored_study


def sense_record(
    folder: Path, path: Path, read: ReadOptions, options: SenseOptions, study: Path | None = None
) -> tuple[SensedMotion, str]:
    """The motion at the unmeasured channels in `options`, estimated from a record, and the title of the model's study.

    Parameters
    ----------
    folder : Path
        Results folder of the identification.
    path : Path
        File of the record, which must hold time histories.
    read : ReadOptions
        Options with which the record is read.
    options : SenseOptions
        Channels wanted, unknown forces and sensors to leave out.
    study : Path, optional
        The study file, if it was moved since the identification.

    Raises
    ------
    InputError
        If the folder, the record or a channel cannot be used.
    NoAnswerError
        If the identification did not determine the model, or the sensors do not determine the motion.
    """
    if not split_commas(options.wanted):
        raise InputError("`wanted` must name where motion is wanted, such as 12Y, got none", "wanted")
    wanted = distinct_channels("wanted", parse_outputs(split_commas(options.wanted)))
    source = stored_study(folder, study)
    model = stored_model(folder, source)
    record = read_record(path, read)
    if not isinstance(record, TimeRecord):
        raise InputError(f"{path}: holds FRFs; motion at other places is computed from time histories")
    unknown = None
    if options.unknown:
        unknown = UnknownForces(split_commas(options.unknown), options.correlation_time, options.force_std)
    left = split_commas(options.leave_out)
    sensed = sense(
        model,
        record,
        wanted,
        options.motion,
        unknown,
        left,
        options.draws,
        is_filtered=not options.unfiltered,
    )
    doubt = stored_doubt(folder)
    if doubt:
        sensed = replace(sensed, words=(doubt, *sensed.words))
    return sensed, source.title


def sensed_csv(sensed: SensedMotion) -> str:
    """CSV text of the estimated motion and forces: a header, then one row for each time.

    Columns are the time (s), then value and standard deviation of every output and of every unknown force (N).
    """
    unit = QUANTITY_UNITS[sensed.motion][0]
    header, columns = ["time (s)"], [sensed.time]
    for dof, value, std in zip(sensed.outputs, sensed.values.T, sensed.std.T, strict=True):
        of_output = output_unit(dof)
        header += [
            f"{dof} ({of_output})" if of_output else f"{dof} {sensed.motion} ({unit})",
            f"{dof} std ({of_output or unit})",
        ]
        columns += [value, std]
    for dof, value, std in zip(sensed.force_dofs, sensed.forces.T, sensed.force_std.T, strict=True):
        header += [f"{dof} force (N)", f"{dof} force std (N)"]
        columns += [value, std]
    return csv_text(header, ([f"{value:.9g}" for value in row] for row in np.column_stack(columns).tolist()))


def sensed_summary(sensed: SensedMotion, folder: Path, path: Path) -> dict[str, StoredEntry]:
    """Content of sensed.json as a dictionary.

    It has the root mean square of each output and unknown force with that of its standard deviation, the errors at
    left-out sensors, the verdict and warnings. `folder` holds the results that the motion was computed from, `path` is
    the record. ``force_spectrum_order`` is None without unknown forces.
    """

    def rows(dofs: tuple[object, ...], values: np.ndarray, std: np.ndarray) -> list[dict[str, StoredEntry]]:
        sizes = np.sqrt((values**2).mean(axis=0)), np.sqrt((std**2).mean(axis=0))
        return [
            {"where": str(dof), "root_mean_square": float(size), "std": float(deviation)}
            for dof, size, deviation in zip(dofs, *sizes, strict=True)
        ]

    return {
        "results": folder.as_posix(),
        "record": path.name,
        "motion": sensed.motion,
        "outputs": list(rows(sensed.outputs, sensed.values, sensed.std)),
        "forces": list(rows(sensed.force_dofs, sensed.forces, sensed.force_std)),
        "force_prior_std": sensed.prior_std,
        "correlation_time_s": sensed.correlation_time,
        "force_frequency_hz": sensed.force_frequency,
        "force_spectrum_order": sensed.force_order if sensed.force_dofs else None,
        "left_out": [{"sensor": str(dof), "error_over_stated_deviation": z} for dof, z in sensed.checks],
        "verdict": "explained" if sensed.is_explained else "wrong_model",
        "contradiction": sensed.contradiction,
        "warnings": list(sensed.words),
    }
