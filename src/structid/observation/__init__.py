"""Parameters and a record become a least-squares problem: whitened residual and its derivatives."""

from structid.observation.equations import measures_everything, one_step_values
from structid.observation.frf import Form, FrfProblem
from structid.observation.motion import Motion, completed, recorded_motion
from structid.observation.motion_fit import RecursiveMotionFit, identify_motion, least_squares_bias, motion_fit
from structid.observation.response import Response, response
from structid.observation.simulation import simulated_record

__all__ = [
    "Form",
    "FrfProblem",
    "Motion",
    "RecursiveMotionFit",
    "Response",
    "completed",
    "identify_motion",
    "least_squares_bias",
    "measures_everything",
    "motion_fit",
    "one_step_values",
    "recorded_motion",
    "response",
    "simulated_record",
]
