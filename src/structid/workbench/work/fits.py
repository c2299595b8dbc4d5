"""Measured and fitted responses of a results folder, as the page overlays them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.dof import parse_dof
from structid.core.errors import FileError
from structid.core.json_types import StoredEntry
from structid.files.hdf5 import hdf5_fields, texts_of
from structid.forward import FrfProblem, RecordProblem
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup
from structid.report.figures.responses import channel_unit
from structid.workbench.work.scene import packed

#: Lines of one channel that are sent of a model at most.
_MOST_LINES = 4000
_FIELDS = ("frequency", "measured", "predicted", "predicted_initial", "outputs", "inputs", "kind")
#: Values of all channels together that are sent at most.
_MOST_VALUES = 400_000


def fitted_responses(folder: Path) -> dict[str, StoredEntry]:
    """Measured, fitted and initial FRF magnitudes of every channel of the first record, those with the largest misfit first.

    ``frequency`` (Hz), and ``channels`` with ``name``, ``quantity``, ``unit``, median relative ``error``, ``measured``,
    ``fitted`` and ``initial``; arrays are packed and thinned to about `_MOST_VALUES` values. If `folder` holds no FRFs,
    ``channels`` is empty, and there is no ``frequency``.

    Raises
    ------
    FileError
        If the responses in estimate.h5 cannot be used.
    """
    path = folder / "estimate.h5"
    if not path.is_file():
        return {"channels": []}
    found = hdf5_fields(path, [f"frf/{name}" for name in _FIELDS])
    if "frf/frequency" not in found:
        return {"channels": []}
    try:
        outputs, inputs = (texts_of(found[f"frf/{name}"]) for name in ("outputs", "inputs"))
        frequency, kind = np.asarray(found["frf/frequency"], dtype=float), texts_of(found["frf/kind"])[0]
        shape = (len(frequency), len(outputs) * len(inputs))
        measured, fitted, initial = (np.asarray(found[f"frf/{name}"]).reshape(shape) for name in _FIELDS[1:4])
    except (KeyError, ValueError) as error:
        raise FileError(f"{path}: its responses cannot be used; run the study again") from error
    size = np.maximum(np.abs(measured), np.finfo(float).tiny)
    errors = np.median(np.abs(fitted - measured) / size, axis=0)
    step = max(1, -(-3 * measured.size // _MOST_VALUES))
    pairs = [(output, load) for output in outputs for load in inputs]
    return {
        "frequency": packed(frequency[::step], np.float64),
        "channels": [
            {
                "name": "/".join(pairs[c]),
                "quantity": kind,
                "unit": channel_unit(kind, *map(parse_dof, pairs[c])),
                "error": float(errors[c]),
                "measured": packed(np.abs(measured[::step, c]), np.float32),
                "fitted": packed(np.abs(fitted[::step, c]), np.float32),
                "initial": packed(np.abs(initial[::step, c]), np.float32),
            }
            for c in np.argsort(-errors, kind="stable").tolist()
        ],
    }


def initial_responses(setup: AnySetup, problem: RecordProblem, options: IdentifyOptions) -> dict[str, StoredEntry]:
    """FRF magnitudes of a model at its start values, at the lines of its record, thinned to about `_MOST_LINES` lines.

    ``frequency`` (Hz), and ``channels`` with ``name`` and ``magnitude``. If the record has no FRFs or the responses are
    not finite, ``channels`` is empty, and there is no ``frequency``.
    """
    problem = setup.shown_problem(options, problem.channels) or problem
    if not isinstance(problem, FrfProblem):
        return {"channels": []}
    values, record = problem.predicted(problem.theta_start), problem.record
    if not np.isfinite(values).all():
        return {"channels": []}
    step = max(1, -(-len(record.frequency) // _MOST_LINES))
    return {
        "frequency": packed(record.frequency[::step], np.float64),
        "channels": [
            {"name": f"{output} / {load}", "magnitude": packed(np.abs(values[::step, o, i]), np.float32)}
            for o, output in enumerate(record.outputs)
            for i, load in enumerate(record.inputs)
        ],
    }
