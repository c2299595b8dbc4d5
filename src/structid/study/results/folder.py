"""The results folder: estimate.json, estimate.h5 and the study as run, whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from structid.core.display import with_unit
from structid.core.errors import FileError
from structid.core.json_types import StoredEntry, json_text
from structid.diagnose.fixed_value_influence import FixedValueSensitivity
from structid.files import claim_path, require_no_file, temporary_path
from structid.identification.alternatives import Alternatives
from structid.identification.identified import Identification
from structid.identification.record_fit import RecordFit
from structid.identification.regularizing import AppliedRegularization
from structid.inversion import Estimate
from structid.inversion.uncertainty import AtBound
from structid.study.results.hdf5 import hdf5_bytes
from structid.study.results.result import StudyResult
from structid.study.results.view import (
    PARAMETERS,
    ParameterResult,
    ResultsView,
    changes_summary,
    changes_table,
    search_summary,
)

if TYPE_CHECKING:
    from structid.identification.modal_fit import ModalFit

#: File that all results of `structid identify` have, and their page.
ESTIMATE, ESTIMATE_PAGE = "estimate.json", "report.html"
#: File of a results folder that says where its study is.
STUDY_PATH = "study_path.txt"
#: Files that results of `structid identify` can have besides.
ESTIMATE_FILES = ("estimate.h5", "study.toml", STUDY_PATH, PARAMETERS, ESTIMATE_PAGE)


def require_results_folder(folder: Path, summary: str, *names: str) -> None:
    """Raise `FileError` if files called `names`, which results could replace, stand in `folder` without `summary`.

    `summary` is the file that results of this kind always have: without it the files are of another command, or
    somebody else's.
    """
    if (folder / summary).exists():
        return
    for name in names:
        if (folder / name).exists():
            raise FileError(
                f"{folder / name}: belongs to no results of this command (there is no {summary} beside it) and could be"
                " replaced; give another folder with --out"
            )


@contextmanager
def staged_folder(folder: str | Path, summary: str, page: str | None = None) -> Iterator[Path]:
    """Context manager that yields a temporary folder, and moves its files into `folder` if no error ends the block.

    On any error the temporary folder is removed, and an existing `folder` stays as it was. Files of `folder` without a
    new one of their name stay, except an old report called `page` beside an old `summary`: it would tell of another
    run. `summary` is the file that results of this kind always have; it is moved first, so that a folder whose writing
    was interrupted is known as theirs.

    Raises
    ------
    FileError
        If `folder` is a file, another process writes to it, or writing fails (disk full, no permission, a file in the
        way).
    """
    folder = Path(folder)
    require_no_file(folder)
    temporary = temporary_path(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with claim_path(folder):
            temporary.mkdir()
            yield temporary
            _move_into(temporary, folder, summary, page)
    except FileError as error:
        raise FileError(str(error).replace(str(temporary), str(folder))) from error
    except OSError as error:
        raise FileError(
            f"{folder}: the results cannot be written ({error.strerror or error}); free disk space, check the"
            " permissions, or give another folder with --out"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _move_into(temporary: Path, folder: Path, summary: str, page: str | None) -> None:
    """Move the files of `temporary` into `folder`: the whole folder at once if there is none, else file by file.

    `summary` goes first. Files of the same names are replaced and others stay, except the report called `page`, which
    is removed if there is no new one and an earlier `summary` stands beside it. `FileError` if `folder` has a link, or a
    file, where a folder goes, or a folder where a file goes; nothing is moved then.
    """
    if not folder.exists():
        temporary.rename(folder)
        return
    for path in temporary.rglob("*"):
        target = folder / path.relative_to(temporary)
        if path.is_dir() and target.is_symlink():  # it may lead out of the folder
            raise FileError(f"{target}: is a link where results have a folder; remove it, or give another --out")
        if target.exists() and target.is_dir() != path.is_dir():
            raise FileError(f"{target}: is in the way of a result of this name; move it, or give another --out")
    if page is not None and not (temporary / page).exists() and (folder / summary).exists():
        (folder / page).unlink(missing_ok=True)  # it would tell of another run
    for path in sorted(temporary.rglob("*"), key=lambda path: (path != temporary / summary, path)):
        target = folder / path.relative_to(temporary)
        if path.is_dir():
            target.mkdir(exist_ok=True)
        else:
            path.replace(target)


def write_results(result: StudyResult, folder: Path) -> None:
    """Write estimate.json, estimate.h5, study.toml and the study file's relative path into the existing `folder`.

    With too many parameters for a covariance matrix their table (CSV) is added, with a solver the updated deck. Equal
    results give equal bytes, except for the path of the study.
    """
    (folder / ESTIMATE).write_text(json_text(estimate_summary(result)), encoding="utf-8")
    if not result.identification.estimate.uncertainty.has_matrix:
        (folder / PARAMETERS).write_text(changes_table(result.identification.estimate), encoding="utf-8")
    (folder / "estimate.h5").write_bytes(hdf5_bytes(result))
    (folder / "study.toml").write_bytes(result.study.text.encode("utf-8"))
    (folder / STUDY_PATH).write_text(_relative_path(result.study.path, folder) + "\n", encoding="utf-8")
    if result.solver is not None:
        result.solver.write(folder)


def _relative_path(path: Path, folder: Path) -> str:
    """The relative path from `folder` to the file `path`; "" if there is none, as between two drives."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return ""


def estimate_summary(result: StudyResult) -> dict[str, StoredEntry]:
    """Content of estimate.json as a dictionary, in which numbers may still be NaN or infinite.

    The file has null for these. It holds the verdict, status, rank, misfit and search, the fit of each record, the
    parameters with intervals (or, without a covariance matrix, those that changed most), model modes, resonances,
    warnings and provenance. Some keys stand there only where they apply: ``polarities``, ``records``,
    ``modal_records``, ``tolerances``, ``varied``, ``alternatives``, ``solver``.
    """
    view, answer = result.view, result.identification
    estimate, identifiability = answer.estimate, answer.estimate.identifiability
    has_matrix = estimate.uncertainty.has_matrix
    return {
        **_verdict(view),
        "title": result.study.title,
        "status": estimate.status.value,
        "status_text": estimate.status_words,
        "message": estimate.message,
        **({} if has_matrix else search_summary(estimate)),
        "rank": identifiability.rank,
        "n_parameters": len(estimate.names),
        "n_free_parameters": int(estimate.spread.is_free.sum()),
        "condition": identifiability.condition,
        "misfit": np.sqrt(estimate.goodness.misfit),
        "misfit_text": estimate.goodness.misfit_words,
        "assumption": answer.assumption,
        "chi_square_per_dof": estimate.chi_square_per_dof,
        "chi_square_probability": estimate.goodness.chi_square_probability,
        "degrees_of_freedom": estimate.goodness.degrees_of_freedom,
        "covariance_basis": estimate.covariance_basis,
        "residual_correlation_lines": estimate.goodness.residual_correlation,
        "n_iterations": estimate.search.n_iterations,
        "n_starts": estimate.search.n_starts,
        "n_agreeing_starts": estimate.search.n_agreeing,
        "fit": fit_summary(answer.fits[0]) if answer.fits else None,
        **record_summaries(answer.fits),
        **modal_summary(answer),
        "total_mass": {"value": answer.mass.total, "std": answer.mass.std, "unit": "kg"},
        "scale_from_force": answer.mass.scale_from_force,
        **_fixed_values(view.diagnosis.sensitivities),
        **_tolerances(estimate),
        **({"parameters": [_parameter(one) for one in view.parameters]} if has_matrix else changes_summary(estimate)),
        "regularization": [
            {"name": item.name, "rule": item.rule, **_strengths(item, has_matrix), "text": item.words,
             "settled": item.converged}
            for item in answer.priors.regularizations
        ],
        **varied_summary(answer),
        **_alternatives(answer.alternatives),
        "unidentifiable_directions": [
            {"words": item.words, "relative_std": item.relative_std, "vector": item.vector}
            for item in identifiability.directions
        ],
        "collinear_groups": [
            {"words": g.words, "members": g.members, "relative_std_alone": g.alone, "relative_std_together": g.together}
            for g in identifiability.groups
        ],
        **({"correlation": estimate.spread.correlation} if has_matrix else {}),
        "modes": [
            {"frequency_hz": frequency, "damping_ratio": ratio}
            for frequency, ratio in zip(answer.modes.frequency, answer.modes.damping_ratio, strict=True)
        ],
        "resonances": [{"measured_hz": r.measured, "predicted_hz": r.predicted} for r in answer.resonances],
        "residual_tests": None if estimate.goodness.residual_tests is None else asdict(estimate.goodness.residual_tests),
        "intervals": {"kind": answer.intervals.kind, "level": answer.intervals.level, "notes": answer.intervals.notes},
        "warnings": answer.warnings,
        **reduction_summary(answer),
        **({} if result.solver is None else {"solver": result.solver.summary()}),
        "provenance": asdict(result.provenance),
    }  # fmt: skip


def _fixed_values(sensitivities: Sequence[FixedValueSensitivity]) -> dict[str, StoredEntry]:
    """The entry ``fixed_values``: sensitivity of the parameters to each fixed value; {} if that was not computed."""
    if not sensitivities:
        return {}
    return {
        "fixed_values": [
            {
                "name": one.name,
                "percent_per_percent": dict(zip(one.parameters, one.influence.tolist(), strict=True)),
                "relative_change_by_record": one.pull,
                "relative_change_std": one.pull_std,
            }
            for one in sensitivities
        ]
    }


def _tolerances(estimate: Estimate) -> dict[str, StoredEntry]:
    """Dictionary with the entry ``tolerances``: name, kind, tolerance and requested change of each fixed value.

    ``tolerance`` is a relative standard deviation, ``asked_in_tolerances`` the change that the data ask for as a
    multiple of it. An empty dictionary if no tolerances were taken into account.
    """
    fixed = estimate.fixed
    if fixed is None:
        return {}
    return {
        "tolerances": [
            {"name": name, "kind": kind, "tolerance": tolerance, "asked_in_tolerances": asked}
            for name, kind, tolerance, asked in zip(fixed.names, fixed.kinds, fixed.tolerance, fixed.asked, strict=True)
        ]
    }


def _alternatives(sets: Alternatives | None) -> dict[str, StoredEntry]:
    """Dictionary with the entry ``alternatives``: sets of parameter values that fit the data equally well, and texts.

    It is empty for `sets` None. Each set has its values by parameter name, the sum of squares, and the number of
    searches that ended there; ``exhaustive`` is True if searches were made until no more sets are to be expected.
    ``deciding`` is the measurement that would decide between the sets; None if none is known.
    """
    if sets is None:
        return {}
    rows = zip(sets.values, sets.cost, sets.n_searches, strict=True)
    return {
        "alternatives": {
            "text": sets.words,
            "searches_text": sets.search_words,
            "exhaustive": sets.is_exhaustive,
            "sets": [
                {
                    "values": dict(zip(sets.names, values.tolist(), strict=True)),
                    "sum_of_squares": cost,
                    "n_searches": count,
                }
                for values, cost, count in rows
            ],
            "deciding": None if sets.deciding is None else asdict(sets.deciding),
        }
    }


def reduction_summary(identification: Identification) -> dict[str, StoredEntry]:
    """The entry ``reduction``: texts on reduced components and on the error of the reduction; {} if nothing is reduced."""
    parts, changes = (
        [one.words for one in told] for told in (identification.structure.reductions, identification.truncations)
    )
    return {"reduction": {"components": parts, "changes": changes}} if changes else {}


def varied_summary(identification: Identification) -> dict[str, StoredEntry]:
    """Dictionary with the entry ``varied``: parameters that vary between records, with their scatter; {} if none do.

    Each has name, rule, scatter with its 95 % interval and, under ``records``, for each record the value there with its
    standard deviation, 95 % interval, deviation from the common value (in scatters), p-value and whether it is an
    outlier.
    """
    if not identification.priors.varied:
        return {}
    index_of = {name: i for i, name in enumerate(identification.estimate.names)}
    return {
        "varied": [
            {
                "name": item.name, "rule": item.rule, "scatter": item.scatter, "scatter_interval_95": item.interval,
                "text": item.words, "outlying": item.outlying_words,
                "records": [
                    {"record": record, "name": own, "value": identification.estimate.values[index_of[own]],
                     "std": identification.estimate.std[index_of[own]], "interval_95": identification.intervals.ends[index_of[own]],
                     "deviation": deviation, "p_value": p, "outlying": outlying}
                    for record, _, own, deviation, p, outlying in item.parts
                ],
            }
            for item in identification.priors.varied
        ]
    }  # fmt: skip


def _verdict(view: ResultsView) -> dict[str, StoredEntry]:
    """The entries on the verdict: its reasons, the next step, advice, causes and suggestions.

    The keys are ``verdict``, ``verdict_text``, ``verdict_reasons``, ``headline``, ``next_step``, ``advice``, ``causes``,
    ``suggestions`` and ``n_changes_tried``; causes and suggestions are as in `Diagnosis`.
    """
    diagnosis, judgement = view.diagnosis, view.diagnosis.judgement
    causes, suggestions = (
        [{**asdict(cause), "where": cause.where[0] if len(cause.where) == 1 else cause.where} for cause in listed]
        for listed in (diagnosis.causes, diagnosis.suggestions)
    )
    return {
        "verdict": judgement.verdict, "verdict_text": judgement.words, "verdict_reasons": judgement.reasons,
        "headline": view.headline, "next_step": view.next_step, "advice": view.advice,
        "causes": causes, "suggestions": suggestions, "n_changes_tried": diagnosis.n_tried,
    }  # fmt: skip


def _strengths(item: AppliedRegularization, has_matrix: bool) -> dict[str, StoredEntry]:
    """The entry ``strengths``, one for each row of a regularization, or ``strength`` and ``n_determined`` without `has_matrix`.

    Without a matrix the regularization is a smoothness over very many rows, which all have the same strength.
    """
    return (
        {"strengths": item.strengths}
        if has_matrix
        else {"strength": item.strengths[0], "n_determined": item.determined}
    )


def record_summaries(fits: Sequence[RecordFit]) -> dict[str, StoredEntry]:
    """Dictionary with ``records``, the fit of each of several records.

    For one record, ``polarities`` if the data decided any, else {}. An entry of ``records`` has the record's name,
    source, decided polarities of channels, and the statistics of its fit.
    """
    if len(fits) > 1:
        rows = [
            {"name": fit.name, "source": fit.measured.source, "polarities": fit.polarities, **fit_summary(fit)}
            for fit in fits
        ]
        return {"records": rows}
    polarities = fits[0].polarities if fits else {}
    return {"polarities": polarities} if polarities else {}


def fit_summary(fit: RecordFit) -> dict[str, StoredEntry]:
    """Fit of the identified model to a record: relative errors, over all lines of the evaluation band and for each channel.

    The keys are ``median_relative_error``, ``n_lines``, ``band_hz``, ``n_lines_fitted``, ``band_fitted_hz``, ``kind``, ``unit``,
    ``noise_source`` and ``channels``.
    """
    error, record, fitted = fit.relative_error, fit.evaluation, fit.problem.record
    channels: list[StoredEntry] = [
        {"output": str(output), "input": str(load), "median_relative_error": float(np.median(error[:, o, i]))}
        for o, output in enumerate(record.outputs)
        for i, load in enumerate(record.inputs)
    ]
    return {
        "median_relative_error": float(np.median(error)),
        "n_lines": len(record.frequency),
        "band_hz": [record.frequency[0], record.frequency[-1]],
        "n_lines_fitted": len(fitted.frequency),
        "band_fitted_hz": [fitted.frequency[0], fitted.frequency[-1]],
        "kind": record.kind,
        "unit": record.unit,
        "noise_source": record.noise_source,
        "channels": channels,
    }


def _at_bound(bound: AtBound | None) -> dict[str, StoredEntry] | None:
    """The entry of a parameter at a bound: its side, limit, and how hard the data push it beyond; None if it is at none."""
    if bound is None:
        return None
    return {
        "side": bound.side,
        "limit": bound.limit,
        "multiplier": bound.multiplier,
        "std_without_bound": bound.std,
        "chi_square_gain_per_std": bound.gain_per_std,
        "push": bound.push,
    }


def _parameter(parameter: ParameterResult) -> dict[str, StoredEntry]:
    return {
        "name": parameter.name,
        "kind": parameter.kind,
        "property": parameter.name.split("[")[0],
        "elements": parameter.elements,
        "unit": parameter.unit,
        "value": parameter.value,
        "std": parameter.std,
        "std_noise": parameter.std_noise,
        "std_model_error": parameter.std_model_error,
        "std_tolerances": parameter.std_tolerances,
        "interval_95": parameter.interval,
        "initial": parameter.initial,
        "identified": parameter.identified,
        "state": parameter.state,
        "text": with_unit(parameter.value_text, parameter.unit_text),
        "interval_text": parameter.interval_with_unit,
        "at_bound": _at_bound(parameter.bound),
        "ran_away": parameter.ran_away,
        "prior_mean": parameter.prior_mean,
        "prior_std": parameter.prior_std,
        "prior_share": parameter.prior_share,
    }


def modal_summary(identification: Identification) -> dict[str, StoredEntry]:
    """Dictionary with ``modal_records`` and ``ratios`` of estimate.json; {} if no record holds modes.

    ``modal_records`` has an entry for each record of modes; ``ratios`` has the parameters relative to a reference
    parameter, or None where the identification gives no ratios.
    """
    if not identification.modal_fits:
        return {}
    ratios = identification.mass.ratios
    if ratios is None:
        return {"modal_records": [_record(fit) for fit in identification.modal_fits], "ratios": None}
    rows = zip(ratios.names, ratios.values, ratios.std, ratios.ends, strict=True)
    return {
        "modal_records": [_record(fit) for fit in identification.modal_fits],
        "ratios": {
            "text": ratios.words,
            "reference": ratios.reference,
            "parameters": [
                {"name": name, "ratio": value, "std": std, "interval_95": ends} for name, value, std, ends in rows
            ],
        },
    }


def _record(fit: ModalFit) -> dict[str, StoredEntry]:
    """Entry of estimate.json on a record of modes: each measured mode, its pair in the initial and in the fitted model.

    It has name, source, form of the shapes, channels, ``modes`` and ``unpaired_model_modes_hz``. Modes are numbered
    from 1, both measured modes and those of the model.
    """
    problem = fit.problem
    sizes = {int(mode): len(group.members) for group in problem.data.groups for mode in group.members}
    damping = problem.record.damping_ratio[problem.data.measured]
    return {
        "name": fit.name,
        "source": fit.measured.source,
        "form": problem.settings.form,
        "channels": [str(dof) for dof in fit.measured.channels],
        "modes": [
            {
                "measured": int(mode) + 1,
                "frequency_hz": problem.record.frequency[mode],
                "frequency_std_hz": problem.data.frequency_std[i],
                "damping_ratio": damping[i],
                "multiplicity": sizes[int(mode)],
                "model_mode": int(fit.fitted.number[i]) + 1,
                "model_frequency_hz": fit.fitted.frequency[i],
                "model_damping_ratio": fit.fitted.damping_ratio[i],
                "mac": fit.fitted.mac[i],
                "largest_principal_angle_deg": float(np.degrees(fit.fitted.angle[i])),
                "initial_model_mode": int(fit.initial.number[i]) + 1,
                "initial_model_frequency_hz": fit.initial.frequency[i],
                "initial_mac": fit.initial.mac[i],
            }
            for i, mode in enumerate(problem.data.measured)
        ],
        "unpaired_model_modes_hz": fit.fitted.passed_over,
    }
