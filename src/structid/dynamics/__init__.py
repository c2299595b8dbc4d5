"""Modes and responses: pure functions of mass, damping and stiffness."""

from structid.dynamics.modes import Modes, modes
from structid.dynamics.receptance import harmonic_fields

__all__ = ["Modes", "harmonic_fields", "modes"]
