"""Modes and responses: pure functions of mass, damping and stiffness."""

from structid.dynamics.free_decay import FreeDecay, free_decay
from structid.dynamics.normal_modes import Modes, modes
from structid.dynamics.transient import Transient, harmonic_transient, sampled_transient

__all__ = [
    "FreeDecay",
    "Modes",
    "Transient",
    "free_decay",
    "harmonic_transient",
    "modes",
    "sampled_transient",
]
