"""Parameters and a record become a least-squares problem: whitened residual and its derivatives."""

from structid.forward.channel_errors import ChannelErrors
from structid.forward.channel_unknowns import ChannelUnknown, channel_errors
from structid.forward.frf.equations import measures_everything, one_step_values
from structid.forward.frf.forms import Form
from structid.forward.frf.problem import FrfProblem, frequency_continuation
from structid.forward.frf.response import Response, ResponseCache, response
from structid.forward.frf.simulation import simulated_record
from structid.forward.modal.problem import ModalProblem
from structid.forward.modal.settings import ModalForm, ModalSettings, ShapeForm
from structid.forward.motion.fit import RecursiveMotionFit, identify_motion, least_squares_bias, motion_fit
from structid.forward.motion.motion import Motion, completed, recorded_motion
from structid.forward.motion.stream import (
    MotionSolution,
    identify_motion_by_chunks,
    load_motion_fit,
    motion_solution,
    reduced_by_chunks,
    save_motion_fit,
)
from structid.forward.record_problem import RecordProblem
from structid.forward.time.identify_time import identify_time
from structid.forward.time.options import Oscillation, TimeOptions
from structid.forward.time.output_error import OutputErrorProblem
from structid.forward.time.problem import output_error_problem
from structid.forward.time.simulation import simulated_time_record
from structid.forward.time.spectra import SpectraProblem, damped_stages, spectra_problem

__all__ = [
    "ChannelErrors",
    "ChannelUnknown",
    "Form",
    "FrfProblem",
    "ModalForm",
    "ModalProblem",
    "ModalSettings",
    "Motion",
    "MotionSolution",
    "Oscillation",
    "OutputErrorProblem",
    "RecordProblem",
    "RecursiveMotionFit",
    "Response",
    "ResponseCache",
    "ShapeForm",
    "SpectraProblem",
    "TimeOptions",
    "channel_errors",
    "completed",
    "damped_stages",
    "frequency_continuation",
    "identify_motion",
    "identify_motion_by_chunks",
    "identify_time",
    "least_squares_bias",
    "load_motion_fit",
    "measures_everything",
    "motion_fit",
    "motion_solution",
    "one_step_values",
    "output_error_problem",
    "recorded_motion",
    "reduced_by_chunks",
    "response",
    "save_motion_fit",
    "simulated_record",
    "simulated_time_record",
    "spectra_problem",
]
