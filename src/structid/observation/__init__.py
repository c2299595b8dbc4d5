"""Parameters and a record become a least-squares problem: whitened residual and its derivatives."""

from structid.observation.frf import Form, FrfProblem
from structid.observation.response import Response, response

__all__ = ["Form", "FrfProblem", "Response", "response"]
