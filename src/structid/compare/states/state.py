"""States as a comparison takes them: of a study that is run, or of an earlier run's results; of two, what stays unchanged."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from structid.core.arrays import FloatArray, locked
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError
from structid.diagnose.verdict import NOT_TRIED, Judgement, Verdict, judged
from structid.fem import Structure
from structid.files.hdf5 import hdf5_fields, texts_of
from structid.identification.mesh_pieces import MESH_WARNINGS
from structid.inversion import Estimate, Status
from structid.inversion.comparison.comparison import Identified
from structid.study.results.result import StudyResult
from structid.study.schema.model.structure import read_structure
from structid.study.schema.root import InputFiles, read_study_text
from structid.study.schema.section import Section
from structid.study.schema.unknowns import read_parameters
from structid.unknowns import Parameters, joint_prior
from structid.unknowns.named_unknowns import begun_at


@dataclass(frozen=True, eq=False)
class StoredChanges:
    """Influence of fixed values as a results folder stores it; the attributes are those of `FixedValueInfluence`."""

    change_names: tuple[str, ...]
    change_tolerances: tuple[float, ...]
    changes: FloatArray


@dataclass(frozen=True, eq=False)
class StoredEstimate:
    """Estimate as a results folder stores it; the attributes are those of `Estimate`."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    status: Status
    covariance_of_data: FloatArray
    fixed: StoredChanges | None = None


@dataclass(frozen=True, eq=False)
class DrawableStructure:
    """Structure, parameters and channels for a drawing of the state.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
    outputs, inputs : tuple of Dof
    """

    structure: Structure
    parameters: Parameters
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]


@dataclass(frozen=True, eq=False)
class State:
    """One side of a comparison.

    Attributes
    ----------
    title : str
    path : Path
        Study file or results folder.
    estimate : Estimate or StoredEstimate
    inputs : mapping of str to str
        SHA-256 of the input files.
    result : StudyResult or None
        Of a study that was run just now.
    regularizations : tuple of str
        Names of the regularizations that hold its parameters.
    drawn : DrawableStructure or None
        None where the study of a results folder cannot be read without the files beside it.
    judgement : Judgement
        The verdict, and its words.
    mesh_warnings : tuple of str
        On what a coarse mesh does to its values.
    """

    title: str
    path: Path
    estimate: Estimate | StoredEstimate
    inputs: Mapping[str, str]
    result: StudyResult | None
    regularizations: tuple[str, ...]
    drawn: DrawableStructure | None
    judgement: Judgement
    mesh_warnings: tuple[str, ...] = ()

    @property
    def doubt(self) -> str:
        """The verdict in words; "" where the answer is sound."""
        return "" if self.judgement.verdict == "sound" else self.judgement.words

    @property
    def is_wrong(self) -> bool:
        """True if the model does not explain the record."""
        return self.judgement.verdict == "wrong_model"


def state_of(result: StudyResult) -> State:
    """The state of a study, from the result of a run; its verdict is without a search for causes."""
    identification = result.identification
    drawn = DrawableStructure(
        identification.structure, identification.parameters, identification.sensors, identification.loads
    )
    study = result.study
    regularizations = tuple(item.name for item in identification.priors.regularizations)
    judgement = judged(identification, untried=NOT_TRIED)
    return State(
        study.title,
        study.path,
        identification.estimate,
        result.provenance.inputs,
        result,
        regularizations,
        drawn,
        judgement,
        _on_mesh(identification.warnings),
    )


def _on_mesh(warnings: Iterable[object]) -> tuple[str, ...]:
    return tuple(words for words in map(str, warnings) if words.startswith(MESH_WARNINGS))


def stored_state(folder: Path) -> State:
    """The state stored in a results folder of `structid identify`, for comparison with another.

    Raises
    ------
    InputError
        If estimate.json or estimate.h5 is missing or cannot be read, or the search was matrix-free (`FileError`).
    """
    texts = {}
    for name in ("estimate.json", "estimate.h5"):
        if not (folder / name).is_file():
            raise FileError(f"{folder}: holds no {name}; give a results folder of `structid identify`, or a study file")
    try:
        texts = json.loads((folder / "estimate.json").read_text(encoding="utf-8"))
        if texts.get("search") == "matrix_free":
            raise FileError(
                f"{folder}: is of search 'matrix_free', which gives no covariance matrix to compare by; group the unknowns"
                " and identify again without it"
            )
        estimate, channels = _stored_estimate(
            folder / "estimate.h5", Status(texts["status"]), texts["covariance_basis"]
        )
        inputs = dict(texts["provenance"]["inputs"])
        regularizations = tuple(str(item["name"]) for item in texts.get("regularization", ()))
    except FileError:
        raise
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder}: its estimate.json and estimate.h5 cannot be used ({error}); write them again with"
            " `structid identify`"
        ) from error
    title, drawn = str(texts.get("title", folder.name)), _read_drawn(folder, channels)
    judgement = Judgement(cast(Verdict, texts.get("verdict", "sound")), str(texts.get("verdict_text", "")))
    mesh_warnings = _on_mesh(texts.get("warnings", ()))
    return State(title, folder, estimate, inputs, None, regularizations, drawn, judgement, mesh_warnings)


def _stored_estimate(path: Path, status: Status, basis: str) -> tuple[StoredEstimate, dict[str, tuple[str, ...]]]:
    """The estimate stored in estimate.h5, and the names of its channels under ``outputs`` and ``inputs``.

    `basis` is "noise" or "model_error" and chooses the covariance, to which that of fixed values is added.

    Raises
    ------
    ValueError
        If arrays differ in their number of parameters.
    """
    names, matrix = ("names", "kinds", "units"), f"covariance_{basis}"
    of_channels = ("frf/outputs", "frf/inputs", "modal_record_1/channels")
    fixed_keys = [f"parameters/{name}" for name in ("fixed_names", "fixed_tolerances", "fixed_changes")]
    of_parameters = [f"parameters/{name}" for name in (*names, "values", matrix)]
    fields = hdf5_fields(path, (*of_channels, *of_parameters, *fixed_keys))
    texts = {name: texts_of(fields[f"parameters/{name}"]) for name in names}
    values = np.asarray(fields["parameters/values"], dtype=float)
    covariance = np.asarray(fields[f"parameters/{matrix}"], dtype=float)
    if "frf/outputs" in fields:
        channels = {"outputs": texts_of(fields["frf/outputs"]), "inputs": texts_of(fields["frf/inputs"])}
    else:
        channels = {"outputs": texts_of(fields["modal_record_1/channels"]), "inputs": ()}
    n = len(values)
    if covariance.shape != (n, n) or any(len(words) != n for words in texts.values()):
        raise ValueError("parameters of different numbers")
    fixed, of_data = None, locked(covariance)
    if fixed_keys[0] in fields:
        tolerances, changes = (np.asarray(fields[key], dtype=float) for key in fixed_keys[1:])
        if changes.shape != (n, len(tolerances) + 1):
            raise ValueError("changes by fixed values of other numbers")
        of_each = (*tolerances.tolist(), 0.0)  # the second order is last
        fixed = StoredChanges(texts_of(fields[fixed_keys[0]]), of_each, locked(changes))
        covariance = covariance + changes @ changes.T
    estimate = StoredEstimate(
        texts["names"], texts["kinds"], texts["units"], locked(values), locked(covariance), status, of_data, fixed
    )
    return estimate, channels


def _read_drawn(folder: Path, channels: dict[str, tuple[str, ...]]) -> DrawableStructure | None:
    """Structure, parameters and channels of study.toml in `folder`, for a drawing; None if they cannot be read.

    `channels` has the names of the channels under ``outputs`` and ``inputs``.
    """
    try:
        source = read_study_text(folder / "study.toml")
        root = Section(source, (), source.table)
        section = root.section("structure")
        if section is None:
            return None
        structure = read_structure(section, InputFiles(folder))
        unknown = read_parameters(root, structure)
        return DrawableStructure(structure, unknown, parse_dofs(channels["outputs"]), parse_dofs(channels["inputs"]))
    except InputError:
        return None


def unchanged_parameters(baseline: Identified, later: Parameters, patterns: Sequence[str]) -> tuple[str, ...]:
    """Names of parameters in both states that match any of `patterns`, each once, in the order of the patterns.

    A pattern is a full name, a kind such as ``mass``, or a text in which ``*`` stands for any characters.

    Raises
    ------
    InputError
        If a pattern chooses nothing that both states identify.
    """
    common = [(n, k) for n, k in zip(baseline.names, baseline.kinds, strict=True) if n in later.names]
    chosen: list[str] = []
    for pattern in patterns:
        expression = re.compile(".*".join(map(re.escape, pattern.split("*"))))
        matches = [n for n, k in common if pattern == k or expression.fullmatch(n)]
        if not matches:
            have = ", ".join(dict.fromkeys(k for _, k in common)) or "none"
            raise InputError(
                f"`unchanged` must name parameters that both states identify, got {pattern!r}; kinds that both have:"
                f" {have}"
            )
        chosen += matches
    return tuple(dict.fromkeys(chosen))


def carried(baseline: Identified, later: Parameters, unchanged: Sequence[str]) -> Parameters:
    """The later state's parameters, started at the baseline's values, with its result as the prior of the unchanged ones.

    Parameters
    ----------
    baseline : Estimate or StoredEstimate
    later : Parameters
    unchanged : sequence of str
        Names; see `unchanged_parameters`. Their prior is the Gaussian of the baseline with all its correlations, so
        that what the baseline does not know of them is not known later either; without names there is no prior. Pass the
        same names to `compare_states` as `carried`.

    Raises
    ------
    InputError
        If the baseline does not determine one of them.
    """
    later = begun_at(later, dict(zip(baseline.names, baseline.values.tolist(), strict=True)))
    if not unchanged:
        return later
    index_of = {name: i for i, name in enumerate(baseline.names)}
    rows = [index_of[name] for name in unchanged]
    return later.coupled(
        joint_prior(
            "baseline",
            later.names,
            tuple(unchanged),
            baseline.values[rows],
            baseline.covariance_of_data[np.ix_(rows, rows)],
            logarithmic=bool((baseline.values[rows] > 0).all()),
        )
    )
