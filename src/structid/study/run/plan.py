"""The plan that a study file asks for."""

from __future__ import annotations

from structid.errors import SingularModelError
from structid.planning.plan import plan
from structid.planning.planned import Plan
from structid.study.schema.plan import PlanStudy


def planned(study: PlanStudy) -> Plan:
    """The plan that a study file asks for.

    Raises
    ------
    StudyError, SingularModelError
        If it cannot be made; with the place in the file.
    """
    try:
        with (study.root.section("plan") or study.root).located():
            return plan(study.structure, study.parameters, study.options)
    except SingularModelError as error:
        place = study.root.section("structure") or study.root
        raise SingularModelError(str(place.error(str(error)))) from error
