"""What is unknown: names, units, groups of elements, transforms, bounds and priors."""

from structid.parameters.field import Field
from structid.parameters.named_unknowns import NamedUnknowns
from structid.parameters.parameters import Parameters, parameters
from structid.parameters.penalties import Regularization, Smoothness, Sparsity, penalty, term_name
from structid.parameters.priors import Coupling, Prior, joint_prior
from structid.parameters.transforms import Transforms
from structid.parameters.unknown import Unknown

__all__ = [
    "Coupling",
    "Field",
    "NamedUnknowns",
    "Parameters",
    "Prior",
    "Regularization",
    "Smoothness",
    "Sparsity",
    "Transforms",
    "Unknown",
    "joint_prior",
    "parameters",
    "penalty",
    "term_name",
]
