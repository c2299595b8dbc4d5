"""plan.json: every number of a plan."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from structid._version import __version__
from structid.core.dof import Dof
from structid.core.json_types import StoredEntry, json_text
from structid.planning.planned import Plan, PlannedTest, SmallestTest
from structid.study.schema.plan import PlanStudy

#: Name of the page that is written beside plan.json.
PLAN_PAGE = "plan.html"


def write_plan(plan: Plan, study: PlanStudy, folder: Path) -> None:
    """Write plan.json and study.toml into the existing `folder`; the same plan gives the same bytes."""
    summary = plan_summary(plan, study.title, study.notes, study.digests)
    (folder / "plan.json").write_text(json_text(summary), encoding="utf-8")
    (folder / "study.toml").write_bytes(study.text.encode("utf-8"))


def plan_summary(
    plan: Plan, title: str = "", notes: tuple[str, ...] = (), inputs: Mapping[str, str] | None = None
) -> dict[str, StoredEntry]:
    """The content of plan.json, in which numbers may still be NaN or infinite.

    The keys are ``title``, ``determined``, ``notes``, ``options``, ``parameters``, ``tests``, ``next_sensors``, ``enough``,
    ``rank``, ``condition``, ``undetermined_directions``, ``collinear_groups``, ``provenance``.

    Parameters
    ----------
    plan : Plan
        The test plan.
    title : str
        Title of the study.
    notes : tuple of str
        Remarks on the origin of the options.
    inputs : mapping of str to str, optional
        SHA-256 of each input file, by name.
    """
    options = plan.options
    return {
        "title": title,
        "determined": plan.determined,
        "notes": notes,
        "options": {
            "kind": options.kind,
            "relative_noise": options.relative_noise,
            "absolute_noise": options.absolute_noise,
            "criterion": options.criterion,
            "of_interest": options.of_interest,
            "target": options.target,
            "n_sensors": options.n_sensors,
            "n_loads": options.n_loads,
            "n_frequencies": options.n_frequencies,
            "frequency_hz": options.frequency,
            "sensors": _texts(options.sensors),
            "loads": _texts(options.loads),
            "installed_sensors": _texts(options.installed_sensors),
            "installed_loads": _texts(options.installed_loads),
        },
        "parameters": [
            {
                "name": name,
                "kind": plan.parameters.kinds[i],
                "unit": plan.parameters.units[i],
                "initial": plan.parameters.start[i],
                "of_interest": bool(plan.chosen.of_interest[i]),
                "prior_std": plan.parameters.priors.std[i],
            }
            for i, name in enumerate(plan.parameters.names)
        ],
        "tests": [_test(plan, test) for test in plan.tests],
        "next_sensors": [_test(plan, test) for test in plan.next_sensors],
        "enough": None if plan.enough is None else _enough(plan, plan.enough),
        "rank": plan.identifiability.rank,
        "condition": plan.identifiability.condition,
        "undetermined_directions": [
            {"words": d.words, "relative_std": d.relative_std, "vector": d.vector}
            for d in plan.identifiability.directions
        ],
        "collinear_groups": [
            {
                "words": group.words,
                "members": group.members,
                "correlation": group.correlation,
                "condition_index": group.condition,
                "alone": group.alone,
                "together": group.together,
            }
            for group in plan.identifiability.groups
        ],
        "provenance": {"structid": __version__, "inputs": dict(inputs or {})},
    }


def _test(plan: Plan, test: PlannedTest) -> dict[str, StoredEntry]:
    return {
        "label": test.label,
        "sensors": _texts(test.sensors),
        "loads": _texts(test.loads),
        "n_lines": len(test.frequency),
        "frequency_hz": test.frequency if len(test.frequency) < len(plan.options.frequency) else None,
        "relative_std": test.std,
        "worst_parameter": plan.parameters.names[test.worst],
        "worst_relative_std": test.worst_std,
        "rms_relative_std": test.rms_std,
        "relative_std_tolerances": test.of_tolerances,
        "worst_relative_std_with_tolerances": test.worst_with_tolerances,
        "n_determined": test.n_determined,
    }


def _enough(plan: Plan, enough: SmallestTest) -> dict[str, StoredEntry]:
    return {
        "target": enough.target,
        "sensors": None if enough.sensors is None else _test(plan, enough.sensors),
        "frequencies": None if enough.frequencies is None else _test(plan, enough.frequencies),
        "averages_factor": enough.averages,
    }


def _texts(dofs: Iterable[Dof]) -> list[str]:
    return [str(dof) for dof in dofs]
