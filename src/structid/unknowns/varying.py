"""Properties that differ from record to record: a common value, and in each record one of its own drawn about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import sparse

from structid.core.arrays import locked
from structid.inversion.comparison.states import OF_RECORD
from structid.unknowns.parameters import Parameters
from structid.unknowns.priors import no_priors


def own_name(name: str, title: str) -> str:
    """What the value of a record is called, such as ``stiffness[clamp] @ record 3``."""
    return f"{name}{OF_RECORD}{title}"


def own_values(parameters: Parameters, title: str) -> Parameters:
    """`parameters` extended for the record `title` by an own value of each varying property beside the common one.

    The properties follow the record's own values; the common ones act only through their scatter.
    """
    common = [name for scatter in parameters.scatters for name in scatter.common]
    if not common:
        return parameters
    index_of = {name: i for i, name in enumerate(parameters.names)}
    columns, n, m = np.array([index_of[name] for name in common]), parameters.n_params, len(common)
    design, is_kept, ranges = parameters.design.tocsc(), np.ones(n), parameters.transforms
    is_kept[columns] = 0.0
    design = sparse.csc_array(sparse.hstack([design @ sparse.diags_array(is_kept), design[:, columns]]))
    design.eliminate_zeros()
    return replace(
        parameters,
        names=(*parameters.names, *(own_name(name, title) for name in common)),
        kinds=(*parameters.kinds, *(parameters.kinds[i] for i in columns)),
        units=(*parameters.units, *(parameters.units[i] for i in columns)),
        elements=(*parameters.elements, *(parameters.elements[i] for i in columns)),
        start=locked(np.concatenate([parameters.start, parameters.start[columns]])),
        transforms=ranges.followed_by(ranges.at(columns)),
        priors=parameters.priors.followed_by(no_priors(m)),
        scale=locked(np.concatenate([parameters.scale, parameters.scale[columns]])),
        couplings=tuple(coupling.among(n + m, 0) for coupling in parameters.couplings),
        design=design,
        scatters=tuple(
            replace(scatter, own=tuple(own_name(name, title) for name in scatter.common))
            for scatter in parameters.scatters
        ),
    )


def with_scatter(parameters: Parameters, std: Mapping[str, float]) -> Parameters:
    """`parameters` with new standard deviations of their scatters; `std` maps names of scatters to deviations."""
    if not parameters.scatters:
        return parameters
    scatters = tuple(replace(scatter, std=std.get(scatter.name, scatter.std)) for scatter in parameters.scatters)
    return replace(parameters, scatters=scatters)
