"""Entries of results with very many parameters: how far each moved, and how that compares with chance."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.json_types import StoredEntry
from structid.files import csv_text
from structid.inversion import Estimate
from structid.inversion.search.least_squares import dense_search_fits

PARAMETERS = "parameters.csv"
#: How many of the largest changes estimate.json names.
_MOST_CHANGES = 50


def search_summary(estimate: Estimate) -> dict[str, StoredEntry]:
    """Entries on a matrix-free search, ``search``, ``reason`` and ``n_determined``: its kind, why, and how many are determined."""
    return {"search": "matrix_free", "reason": search_reason(estimate), "n_determined": estimate.spread.determined}


def search_reason(estimate: Estimate) -> str:
    """Sentence on the memory that a search with a Jacobian would take."""
    return dense_search_fits(len(estimate.names), estimate.goodness.n_data)[1]


def changes_summary(estimate: Estimate) -> dict[str, StoredEntry]:
    """Entries of estimate.json for very many parameters: those that moved most, and the name of the file with all of them.

    The keys are ``n_beyond_chance``, ``chance_limit_std``, ``largest_changes`` and ``parameters_file``.
    """
    beyond, limit = estimate.beyond_chance()
    rows = _columns(estimate)
    return {
        "n_beyond_chance": int(beyond.sum()),
        "chance_limit_std": limit,
        "largest_changes": [
            {key: column[i] for key, column in rows.items()} for i in largest_changes(estimate, _MOST_CHANGES)
        ],
        "parameters_file": PARAMETERS,
    }


def largest_changes(estimate: Estimate, count: int) -> list[int]:
    """Indices of the `count` parameters that moved from their start by most standard deviations, largest change first."""
    size: FloatArray = np.abs(estimate.distance)
    order: list[int] = np.argsort(-np.nan_to_num(size, nan=-1.0), kind="stable")[:count].tolist()
    return order


def changes_table(estimate: Estimate) -> str:
    """All parameters of an estimate as CSV text, one row each; a cell is empty where a number is not finite."""
    columns = _columns(estimate)
    rows = zip(*columns.values(), strict=True)
    return csv_text(columns, (["" if isinstance(v, float) and not np.isfinite(v) else v for v in row] for row in rows))


def _columns(estimate: Estimate) -> dict[str, list[StoredEntry]]:
    """Columns of the table of parameters: name, unit, values, deviations and changes of each."""
    return {
        "name": list(estimate.names),
        "kind": list(estimate.kinds),
        "unit": list(estimate.units),
        "value": estimate.values.tolist(),
        "std": estimate.std.tolist(),
        "std_relative_error": estimate.uncertainty.std_error.tolist(),
        "initial": estimate.initial.tolist(),
        "identified": estimate.identified.tolist(),
        "change_in_std": estimate.distance.tolist(),
    }
