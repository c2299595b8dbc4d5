"""Parameters and a record become a least-squares problem: whitened residual and its derivatives."""

from structid.observation.equations import measures_everything, one_step_values
from structid.observation.frf import Form, FrfProblem
from structid.observation.response import Response, response
from structid.observation.simulation import simulated_record

__all__ = ["Form", "FrfProblem", "Response", "measures_everything", "one_step_values", "response", "simulated_record"]
