"""What estimate.json tells of records of modes."""

from __future__ import annotations

import numpy as np

from structid.core.json_types import Entry
from structid.identification.fits.modal_fit import ModalFit
from structid.identification.identified import Identification


def modal_summary(identification: Identification) -> dict[str, Entry]:
    """The entries ``modal_records`` and ``ratios`` of estimate.json; {} if no record holds modes."""
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


def _record(fit: ModalFit) -> dict[str, Entry]:
    """The entry of one record of modes: each measured mode beside its model modes."""
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
