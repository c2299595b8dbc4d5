"""The ``[method]`` of a study file as `IdentifyOptions`."""

from __future__ import annotations

from structid.estimation import GaussNewton, LevenbergMarquardt
from structid.estimation.intervals.intervals import INTERVAL_KINDS
from structid.identification.identify import IdentifyOptions
from structid.study.schema.section import (
    BOOLEAN,
    COUNT,
    INTEGER,
    NOT_NEGATIVE,
    POSITIVE,
    RANGE,
    RANGES,
    Kind,
    Section,
    choice,
)

_SMALL = Kind(
    "a number above 0 and at most 0.01",
    lambda value: POSITIVE.accepts(value) and value <= 0.01,
)
_SEARCHES = {"levenberg_marquardt": LevenbergMarquardt, "gauss_newton": GaussNewton}
_KINDS = {
    "band": RANGE,
    "evaluation_band": RANGE,
    "exclude": RANGES,
    "residual": choice("output", "log", "pole_free"),
    "model_error": NOT_NEGATIVE,
    "pole_free_start": BOOLEAN,
    "start": choice("near", "continuation"),
    "start_error": POSITIVE,
    "restarts": INTEGER,
    "uniqueness_starts": INTEGER,
    "seed": INTEGER,
    "search": choice(*_SEARCHES, "matrix_free"),
    "max_iterations": COUNT,
    "total_mass_direction": choice("X", "Y", "Z"),
    "n_modes": COUNT,
    "intervals": choice(*INTERVAL_KINDS),
    "reduced": _SMALL,
}


def read_method(section: Section | None) -> IdentifyOptions:
    """The options that ``[method]`` gives; the defaults where there is none."""
    if section is None:
        return IdentifyOptions()
    given = section.values(_KINDS)
    if "search" in given:
        given["matrix_free"] = given["search"] == "matrix_free"
    search = _SEARCHES.get(given.pop("search", ""), LevenbergMarquardt)
    limits = {"max_iterations": given.pop("max_iterations")} if "max_iterations" in given else {}
    if "total_mass_direction" in given:
        given["direction"] = given.pop("total_mass_direction")
    for key in ("band", "evaluation_band"):
        if key in given:
            given[key] = (float(given[key][0]), float(given[key][1]))
    if "exclude" in given:
        given["exclude"] = tuple((float(low), float(high)) for low, high in given["exclude"])
    return IdentifyOptions(method=search(**limits), **given)
