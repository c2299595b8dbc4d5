"""The public names, each with its place; `structid.lazy` reads them from here."""

from structid.dynamics.normal_modes import Modes as Modes
from structid.dynamics.normal_modes import modes as modes
from structid.dynamics.transient import FreeDecay as FreeDecay
from structid.dynamics.transient import Transient as Transient
from structid.dynamics.transient import free_decay as free_decay
from structid.dynamics.transient import harmonic_transient as harmonic_transient
from structid.dynamics.transient import sampled_transient as sampled_transient
