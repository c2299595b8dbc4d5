"""Modes and responses: pure functions of mass, damping and stiffness."""

from structid.dynamics.normal_modes import Modes, modes
from structid.dynamics.transient import FreeDecay, Transient, free_decay, harmonic_transient, sampled_transient

__all__ = [
    "FreeDecay",
    "Modes",
    "Transient",
    "free_decay",
    "harmonic_transient",
    "modes",
    "sampled_transient",
]
