"""Test and model of a study side by side, at its start values or at those of a results folder; and correlation.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from structid.compare.mode_correlation import ModesCorrelation, correlated_modes
from structid.compare.options import DEFAULT, CorrelateOptions
from structid.compare.response_correlation import ResponsesCorrelation, correlated_responses
from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.core.json_types import StoredEntry
from structid.core.provenance import Provenance
from structid.identification.record_fit import FittedUnknowns
from structid.identification.setups.setup import AnySetup, prefixes, titles
from structid.modal import ModalRecord
from structid.study.results.hdf5 import stored_parameters
from structid.study.results.result import provenance
from structid.study.run.check import ChannelCheck, channel_checks
from structid.study.run.start import load_setups, placed_mechanism
from structid.study.schema.records.modes import ModesSource
from structid.study.schema.study import Study, cut_study

Correlation: TypeAlias = ModesCorrelation | ResponsesCorrelation


@dataclass(frozen=True, eq=False)
class StudyCorrelation:
    """Correlation of each record of a study with the model.

    Attributes
    ----------
    study : Study
    at : Path, optional
        Results folder whose values the model has; those of the study's start without one.
    modes : tuple of ModesCorrelation
    responses : tuple of ResponsesCorrelation
    channels : tuple of ChannelCheck
        What each sensor sees of the model, and how far the nearest node is.
    warnings : tuple of str
    provenance : Provenance
    """

    study: Study
    at: Path | None
    modes: tuple[ModesCorrelation, ...]
    responses: tuple[ResponsesCorrelation, ...]
    channels: tuple[ChannelCheck, ...]
    warnings: tuple[str, ...]
    provenance: Provenance

    @property
    def is_paired(self) -> bool:
        """True if a measured mode has a pair, or if there is a record of responses."""
        return bool(self.responses) or any(part.n_paired for part in self.modes)


def correlate(study: Study, options: CorrelateOptions = DEFAULT, at: Path | None = None) -> StudyCorrelation:
    """Compare the records of `study` with its model, at the start values or at the values of a results folder.

    The result has a comparison of modes for each record of modes, and one of FRFs for each other record. Nothing is
    estimated.

    Parameters
    ----------
    study : Study
        Study whose records are read here.
    options : CorrelateOptions
        Least MAC of a pair, reduction and expansion of modes.
    at : Path, optional
        Results folder of `structid identify`; its values replace start values of the same names.

    Raises
    ------
    InputError
        If a record or its sensors cannot be used, or the folder holds no value of the study's parameters.
    SingularModelError
        If the model has a mechanism.
    """
    values: Mapping[str, float] = {}
    if at is not None:
        stored = stored_parameters(at)
        values = stored.values
        study = cut_study(study, stored.pieces) if study.leaves_pieces_open else study
    setups = load_setups(study)
    names = titles(setups) if len(setups) > 1 else [""] * len(setups)
    modal: list[ModesCorrelation] = []
    responses: list[ResponsesCorrelation] = []
    warnings: list[str] = []
    for name, prefix, setup, source in zip(names, prefixes(setups), setups, study.setups, strict=True):
        part: Correlation
        with placed_mechanism(study.section("structure")), source.section.located():
            if source.record.modes is not None:
                part = _compare_modes(name, setup, source.record.modes, values, options)
                modal.append(part)
            else:
                part = _compare_responses(name, setup, study, values)
                responses.append(part)
        warnings += [prefix + words for words in part.warnings]
    channels = tuple(
        check for prefix, setup in zip(prefixes(setups), setups, strict=True) for check in channel_checks(prefix, setup)
    )
    return StudyCorrelation(study, at, tuple(modal), tuple(responses), channels, tuple(warnings), provenance(study))


def _compare_modes(
    name: str, setup: AnySetup, source: ModesSource, values_of_study: Mapping[str, float], options: CorrelateOptions
) -> ModesCorrelation:
    unknown = setup.parameters
    values = unknown.values(values_at(unknown.names, unknown.start, values_of_study))
    return correlated_modes(setup.structure, values, source.load(), options, source.settings, name)


def _compare_responses(
    name: str, setup: AnySetup, study: Study, values_of_study: Mapping[str, float]
) -> ResponsesCorrelation:
    """Measured and modelled FRFs of one record, on its evaluation band.

    `values_of_study` has the parameter values, by name, that replace start values.

    Raises
    ------
    InputError
        If the record has no responses that the model can be compared with.
    """
    problem = setup.prepared(study.options).problem
    values = values_at(problem.names, problem.unknowns.start, values_of_study)
    fit = setup.response_fit(name, problem, FittedUnknowns(problem.theta_start, values, values), study.options)
    if fit is None:
        raise InputError("the record has neither modes nor responses to hold against the model")
    return correlated_responses(fit.evaluation, fit.evaluation_predicted, name)


def values_at(names: tuple[str, ...], start: FloatArray, values: Mapping[str, float]) -> FloatArray:
    """Values (n,) of the parameters `names`: their `start` (n,), replaced by the entry of `values` where it has the name.

    Raises
    ------
    InputError
        If `values` is not empty and has none of the names.
    """
    if values and not any(name in values for name in names):
        raise InputError("the results folder holds none of the study's parameters; give the folder of this study's run")
    return np.array([values.get(name, initial) for name, initial in zip(names, start.tolist(), strict=True)])


def correlation_summary(correlation: StudyCorrelation) -> dict[str, StoredEntry]:
    """Content of correlation.json, with numbers that are not finite; modes count from 1.

    Keys: ``title``, ``at``, ``modal_records``, ``response_records``, ``channels``, ``warnings`` and ``provenance``.
    """
    return {
        "title": correlation.study.title,
        "at": "start values" if correlation.at is None else correlation.at.name,
        "modal_records": [_modes_summary(part) for part in correlation.modes],
        "response_records": [_responses_summary(part) for part in correlation.responses],
        "channels": [asdict(channel) for channel in correlation.channels],
        "warnings": correlation.warnings,
        "provenance": asdict(correlation.provenance),
    }


def _modes_summary(correlation: ModesCorrelation) -> dict[str, StoredEntry]:
    """Content of correlation.json for one record of modes; modes count from 1, and a mode without a pair has None.

    Keys: ``name``, ``source``, ``modes``, ``missing``, ``surplus_model_modes``, ``model_frequency_hz``, ``mac``,
    ``channels``, ``reduction``, ``self_orthogonality``, ``cross_orthogonality`` and ``expansion`` (None without one).
    """
    pairing, expanded = correlation.pairing, correlation.expanded
    number = pairing.number
    rows = [
        {
            "measured": i + 1,
            "frequency_hz": correlation.measured.frequency[i],
            "model_mode": int(number[i]) + 1 if number[i] >= 0 else None,
            "model_frequency_hz": correlation.model.frequency[number[i]] if number[i] >= 0 else None,
            "relative_difference": correlation.frequency_difference[i],
            "mac": pairing.mac[i, number[i]] if number[i] >= 0 else None,
            "mac_std": correlation.mac_of_pairs.std[i],
            "mac_by_noise": correlation.mac_of_pairs.noise_effect[i],
            "likeness": pairing.likeness[i] if number[i] >= 0 else None,
            "model_modes_together": [k + 1 for k in pairing.partners(i)],
            "ambiguous_with": [k + 1 for k in pairing.ambiguous.get(i, ())],
            "remark": correlation.remark(i),
        }
        for i in range(correlation.measured.n_modes)
    ]
    channels = [
        {"channel": str(dof), "comac": correlation.comac[c], "ecomac": correlation.ecomac[c]}
        for c, dof in enumerate(correlation.measured.channels)
    ]
    return {
        "name": correlation.name,
        "source": correlation.measured.source,
        "modes": rows,
        "missing": [int(i) + 1 for i in pairing.missing],
        "surplus_model_modes": [k + 1 for k in pairing.surplus],
        "model_frequency_hz": correlation.model.frequency,
        "mac": pairing.mac,
        "channels": channels,
        "reduction": correlation.options.reduction,
        "self_orthogonality": correlation.self_orthogonality,
        "cross_orthogonality": correlation.cross_orthogonality,
        "expansion": None
        if expanded is None
        else {
            "method": correlation.options.expansion,
            "model_error": correlation.options.model_error,
            "modes": [
                {
                    "measured": i + 1,
                    "model_modes": [k + 1 for k in expanded.basis[i]],
                    "relative_residual": residual,
                    "median_std": median,
                }
                for i, (residual, median) in enumerate(correlation.expansion_sizes)
            ],
        },
    }


def _responses_summary(correlation: ResponsesCorrelation) -> dict[str, StoredEntry]:
    """Content of correlation.json for one record of FRFs.

    Keys: ``name``, ``source``, ``kind``, ``band_hz``, ``frac``, ``fdac_hz``, ``fdac`` and ``resonances``.
    """
    record = correlation.record
    pairs = [
        {"output": str(output), "input": str(load), "frac": correlation.frac[o, i]}
        for o, output in enumerate(record.outputs)
        for i, load in enumerate(record.inputs)
    ]
    return {
        "name": correlation.name,
        "source": record.source,
        "kind": record.kind,
        "band_hz": [record.frequency[0], record.frequency[-1]],
        "frac": pairs,
        "fdac_hz": record.frequency[correlation.map_lines],
        "fdac": [] if correlation.fdac is None else correlation.fdac,
        "resonances": [{"measured_hz": one.measured, "model_hz": one.predicted} for one in correlation.resonances],
    }


def expanded_record(correlation: ModesCorrelation) -> ModalRecord | None:
    """The measured modes as a record with shapes at all degrees of freedom at nodes of the model.

    None without an expansion. Standard deviations of the shapes are left out unless all known entries have one.
    """
    if correlation.expanded is None:
        return None
    in_model = np.array([dof.node in correlation.structure.nodes for dof in correlation.structure.dofs])
    std = correlation.expanded.std[in_model]
    return replace(
        correlation.measured,
        mode_shapes=correlation.expanded.shapes[in_model],
        channels=tuple(dof for dof, is_own in zip(correlation.structure.dofs, in_model, strict=True) if is_own),
        shape_std=std if np.isfinite(std[~np.isnan(correlation.expanded.shapes[in_model])]).all() else None,
        changes=None,
        source=f"{correlation.measured.source}, expanded to the model by {correlation.options.expansion}",
    )
