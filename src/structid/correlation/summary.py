"""The content of correlation.json, and measured shapes on the model as a record of modes."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from structid.correlation.correlating import StudyCorrelation
from structid.correlation.modes import ModesCorrelation
from structid.correlation.responses import ResponsesCorrelation
from structid.modal import ModalRecord
from structid.plain import Entry


def correlation_summary(found: StudyCorrelation) -> dict[str, Entry]:
    """The content of correlation.json, before what is not finite becomes null. Modes count from 1."""
    return {
        "title": found.study.title,
        "at": "start values" if found.at is None else found.at.name,
        "modal_records": [_modes(part) for part in found.modes],
        "response_records": [_responses(part) for part in found.responses],
        "channels": [asdict(channel) for channel in found.channels],
        "warnings": found.warnings,
        "provenance": asdict(found.provenance),
    }


def _modes(part: ModesCorrelation) -> dict[str, Entry]:
    pairing, expanded = part.pairing, part.expanded
    number = pairing.number
    rows = [
        {
            "measured": i + 1,
            "frequency_hz": part.measured.frequency[i],
            "model_mode": int(number[i]) + 1 if number[i] >= 0 else None,
            "model_frequency_hz": part.model.frequency[number[i]] if number[i] >= 0 else None,
            "relative_difference": part.frequency_difference[i],
            "mac": pairing.mac[i, number[i]] if number[i] >= 0 else None,
            "likeness": pairing.likeness[i] if number[i] >= 0 else None,
            "model_modes_together": [k + 1 for k in pairing.partners(i)],
            "ambiguous_with": [k + 1 for k in pairing.ambiguous.get(i, ())],
            "remark": part.remark(i),
        }
        for i in range(part.measured.n_modes)
    ]
    channels = [
        {"channel": str(dof), "comac": part.comac[c], "ecomac": part.ecomac[c]}
        for c, dof in enumerate(part.measured.channels)
    ]
    return {
        "name": part.name,
        "source": part.measured.source,
        "modes": rows,
        "missing": [int(i) + 1 for i in pairing.missing],
        "surplus_model_modes": [k + 1 for k in pairing.surplus],
        "model_frequency_hz": part.model.frequency,
        "mac": pairing.mac,
        "channels": channels,
        "reduction": part.options.reduction,
        "self_orthogonality": part.self_orthogonality,
        "cross_orthogonality": part.cross_orthogonality,
        "expansion": None
        if expanded is None
        else {
            "method": part.options.expansion,
            "model_error": part.options.model_error,
            "modes": [
                {
                    "measured": i + 1,
                    "model_modes": [k + 1 for k in expanded.basis[i]],
                    "relative_residual": residual,
                    "median_std": median,
                }
                for i, (residual, median) in enumerate(expansion_sizes(part))
            ],
        },
    }


def expansion_sizes(part: ModesCorrelation) -> list[tuple[float, float]]:
    """Of every expanded shape: residual at the sensors in parts of the measured shape, and the median standard deviation
    in parts of the largest entry.
    """
    expanded = part.expanded
    if expanded is None:
        return []
    size = np.abs(expanded.shapes).max(axis=0)
    left, whole = (np.nansum(values**2, axis=0) for values in (expanded.residual, part.shapes))
    residual = np.sqrt(np.divide(left, whole, out=np.full(len(whole), np.nan), where=whole > 0))
    median = np.median(expanded.std, axis=0) / np.where(size > 0, size, np.nan)
    return list(zip(residual.tolist(), median.tolist(), strict=True))


def _responses(part: ResponsesCorrelation) -> dict[str, Entry]:
    record = part.record
    pairs = [
        {"output": str(output), "input": str(load), "frac": part.frac[o, i]}
        for o, output in enumerate(record.outputs)
        for i, load in enumerate(record.inputs)
    ]
    return {
        "name": part.name,
        "source": record.source,
        "kind": record.kind,
        "band_hz": [record.frequency[0], record.frequency[-1]],
        "frac": pairs,
        "fdac_hz": record.frequency[part.map_lines],
        "fdac": [] if part.fdac is None else part.fdac,
        "resonances": [{"measured_hz": one.measured, "model_hz": one.predicted} for one in part.resonances],
    }


def expanded_record(part: ModesCorrelation) -> ModalRecord | None:
    """The measured modes with shapes at every degree of freedom of the model; None where there is no expansion."""
    if part.expanded is None:
        return None
    inside = np.array([dof.node in part.structure.nodes for dof in part.structure.dofs])
    std = part.expanded.std[inside]
    return replace(
        part.measured,
        mode_shapes=part.expanded.shapes[inside],
        channels=tuple(dof for dof, is_own in zip(part.structure.dofs, inside, strict=True) if is_own),
        shape_std=std if np.isfinite(std[~np.isnan(part.expanded.shapes[inside])]).all() else None,
        changes=None,
        source=f"{part.measured.source}, expanded to the model by {part.options.expansion}",
    )
