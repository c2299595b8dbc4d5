"""What each part of the measured frame's model brings: one fit a variant, judged on 4.5-85 Hz and all nine channels.

The example starts from drawings and handbook values; every variant starts from the example's answer.

    python benchmarks/accuracy/frame_models.py
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tomllib

import numpy as np

import structid as sid
from structid.study.schema.records.record import load_record

STUDY = Path(__file__).parents[2] / "examples" / "three_storey_frame" / "study.toml"
PLATES = ("plate 0", "plate 1", "plate 2", "plate 3")
RAILS = ("rail A", "rail B")


@dataclass(frozen=True)
class Variant:
    """A change of the example's study: elements and unknowns out or in, directions, options."""

    name: str
    without: tuple[str, ...] = ()
    more: tuple[Any, ...] = ()
    unknown: tuple[sid.Unknown, ...] = ()
    active: tuple[str, ...] | None = None
    fixed: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)
    channels: tuple[sid.ChannelUnknown, ...] = ()


def gain_variants() -> Iterable[Variant]:
    """Gains of the sensors as parameters, with two weights of the data against what is known of the gains."""
    calibrated = sid.ChannelUnknown("gain", "all", each=True, prior=sid.Prior(1.0, 0.025))
    common = sid.ChannelUnknown("gain", inputs="all", prior=sid.Prior(1.0, 0.025))
    free = sid.ChannelUnknown("gain", "all", each=True)
    # 10 % times the root of chi-square per degree of freedom (4.08) and of the 47 lines that the residual stays alike
    honest = {"model_error": 1.4}
    yield Variant("the example, 140 % a line", options=honest)
    yield Variant("nine gains 1 ± 0.025, 140 % a line", channels=(calibrated,), options=honest)
    yield Variant(
        "the same, no hardware, base plate's mass unknown",
        without=("hardware",),
        unknown=(sid.Unknown("mass", "plate 0"),),
        channels=(calibrated,),
        options=honest,
    )
    yield Variant("force gain 1 ± 0.025, 140 % a line", channels=(common,), options=honest)
    yield Variant("nine gains free, 140 % a line", channels=(free,), options=honest)
    yield Variant("nine gains 1 ± 0.025, 10 % a line", channels=(calibrated,))


def variants() -> Iterable[Variant]:
    """The example as it is, and with one thing changed at a time."""
    dashpot = sid.Dashpot("rail drag", "104X", viscous_damping=80.0)
    yield Variant("the example")
    yield Variant("fit on 15-85 Hz", options={"band": (15.0, 85.0)})
    yield Variant("fit on 4.5-85 Hz", options={"band": (4.5, 85.0)})
    yield Variant("relative error of H instead of its logarithm", options={"residual": "output"})
    yield Variant(
        "viscous dashpot instead of dry friction",
        without=RAILS,
        more=(dashpot,),
        unknown=(sid.Unknown("viscous_damping", "rail drag"),),
    )
    yield Variant("no hardware under the base", without=("hardware",))
    yield Variant(
        "no hardware, base plate's mass unknown", without=("hardware",), unknown=(sid.Unknown("mass", "plate 0"),)
    )
    yield Variant("no rocking of the base", without=("rocking",), fixed=("100RY",))
    yield Variant(
        "no yaw and no sideways motion",
        without=("yaw guide", "rail B", *(f"yaw of {p}" for p in PLATES)),
        active=("X", "Z", "RY"),
    )
    yield Variant("no stick of the rails", without=("rail stick",))


def changed(variant: Variant) -> tuple[sid.Structure, sid.Parameters, sid.FrfRecord, sid.IdentifyOptions]:
    """The study with the variant's changes."""
    study = sid.load_study(STUDY)
    base = study.structure
    elements = [e for e in base.elements if e.name not in variant.without] + list(variant.more)
    active = variant.active or base.active
    fixed = [d for d in base.fixed if d.direction in active] + list(variant.fixed)
    structure = sid.Structure(base.nodes, elements, fixed, base.ties, active)
    declared = [sid.Unknown(**u) for u in tomllib.loads(study.text)["unknown"]]
    kept = [u for u in declared if u.elements not in variant.without]
    parameters = sid.parameters(structure, [*kept, *variant.unknown])
    return structure, parameters, load_record(study.record), replace(study.options, **variant.options)


def started_near(parameters: sid.Parameters, answer: sid.Estimate | None) -> sid.Parameters:
    """`parameters` started at the values of `answer` where the names agree."""
    if answer is None:
        return parameters
    known = dict(zip(answer.names, answer.values, strict=True))
    pairs = zip(parameters.names, parameters.start, strict=True)
    return parameters.started_at(np.array([known.get(name, start) for name, start in pairs]))


def gain_words(estimate: sid.Estimate) -> str:
    """Gains with their standard deviations, in the order of the record's sensors."""
    pairs = zip(estimate.names, estimate.values, estimate.std, strict=True)
    return ", ".join(f"{name[5:-1]} {value:.3f} ± {std:.3f}" for name, value, std in pairs if name.startswith("gain["))


def main() -> None:
    """Print a row a variant."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gains", action="store_true", help="the rows with gains of the sensors only")
    parser.add_argument("--rows", type=int, help="the first so many rows only")
    chosen_rows = parser.parse_args()
    print("| model | parameters | median error | plates (kg) | hardware (kg) | total (kg) | resonances (Hz) |")
    print("|---|---|---|---|---|---|---|")
    answer = None
    rows = [next(iter(variants())), *gain_variants()] if chosen_rows.gains else [*variants(), *gain_variants()]
    for variant in rows[: chosen_rows.rows]:
        structure, parameters, record, options = changed(variant)
        chosen = options if answer is None else replace(options, restarts=0, pole_free_start=False)
        near = started_near(parameters, answer)
        found = sid.identify(structure, near, record, chosen, channel_unknowns=variant.channels)
        estimate = found.estimate
        answer = answer or estimate
        values = dict(zip(estimate.names, zip(estimate.values, estimate.std, strict=True), strict=True))
        masses = [values.get(f"mass[{plate}]") for plate in PLATES]
        plates = ", ".join("6.52 (weighed)" if m is None else f"{m[0]:.2f} ± {m[1]:.2f}" for m in masses)
        hardware = values.get("mass[hardware]")
        peaks = ", ".join(f"{r.predicted:.2f}" for r in found.resonances)
        name = variant.name if estimate.status is sid.Status.CONVERGED else f"{variant.name} ({estimate.status.value})"
        lumps = "-" if hardware is None else f"{4 * hardware[0]:.2f} ± {4 * hardware[1]:.2f}"
        total = f"{found.mass.total:.2f} ± {found.mass.std:.2f}"
        error = f"{np.median(found.relative_error):.3f}"
        print(f"| {name} | {len(estimate.names)} | {error} | {plates} | {lumps} | {total} | {peaks} |", flush=True)
        if variant.channels:
            print(f"|   gains: {gain_words(estimate)} | | | | | | |", flush=True)
    print("measured resonances: " + ", ".join(f"{r.measured:.2f}" for r in found.resonances) + " Hz")


if __name__ == "__main__":
    main()
