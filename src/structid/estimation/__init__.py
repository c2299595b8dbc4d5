"""Estimators: they see a problem through its protocol only, and give an `Estimate`."""

from structid.estimation.estimate import Estimate, Status, estimate
from structid.estimation.identifiability import Direction, Identifiability, identifiability
from structid.estimation.least_squares import GaussNewton, LevenbergMarquardt, Minimum, minimize
from structid.estimation.problem import Linearization, Problem
from structid.estimation.streaming_qr import LinearFit, StreamingQr, no_rows

__all__ = [
    "Direction",
    "Estimate",
    "GaussNewton",
    "Identifiability",
    "LevenbergMarquardt",
    "LinearFit",
    "Linearization",
    "Minimum",
    "Problem",
    "Status",
    "StreamingQr",
    "estimate",
    "identifiability",
    "minimize",
    "no_rows",
]
