"""What is unknown: names, units, groups of elements, transforms, bounds and priors."""

from structid.parameters.parameters import Parameters, Prior, Unknown, parameters
from structid.parameters.transforms import Transforms

__all__ = ["Parameters", "Prior", "Transforms", "Unknown", "parameters"]
