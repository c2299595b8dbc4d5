"""Unknown parameters: names, units, groups of elements, transforms, bounds and priors."""

from structid.unknowns.named_unknowns import NamedUnknowns, Transforms
from structid.unknowns.parameters import Parameters, Scatter, own_values, parameters, with_scatter
from structid.unknowns.penalties import Regularization, Smoothness, Sparsity, penalty, term_name
from structid.unknowns.priors import Coupling, Prior, joint_prior
from structid.unknowns.unknown import Field, Unknown

__all__ = [
    "Coupling",
    "Field",
    "NamedUnknowns",
    "Parameters",
    "Prior",
    "Regularization",
    "Scatter",
    "Smoothness",
    "Sparsity",
    "Transforms",
    "Unknown",
    "joint_prior",
    "own_values",
    "parameters",
    "penalty",
    "term_name",
    "with_scatter",
]
