"""Chapter 3 as printed: the free-free beam, its force, and Tables 3.1 to 3.4."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.dynamics.transient import Transient, harmonic_transient
from structid.fem import Beam, Structure
from structid.forward.motion.motion import Motion
from structid.unknowns import Parameters, Unknown
from structid.unknowns.parameters import parameters

N_ELEMENTS = 15
#: Amplitude in N and angular frequency in rad/s of the force at node 7, Eq. (3.22).
FORCE, OMEGA = 0.1, 1.0
FORCED_NODE = 7
#: Time between samples, s.
STEP = 0.5
#: Standard deviation of the noise as a part of the signal.
NOISE = 0.02

# fmt: off
#: Table 3.1: masses (kg/m, printed as kg) and then stiffnesses EI / h^3 (N/m) of the elements.
ACTUAL = np.array([
    8.4, 1.6, 2.3, 4.8, 6.3, 5.2, 7.1, 4.2, 6.3, 1.6, 1.1, 2.4, 3.5, 4.6, 7.3,
    3.3, 2.3, 1.2, 1.3, 3.3, 4.2, 1.8, 1.4, 4.1, 3.6, 5.2, 3.4, 6.6, 2.5, 5.3,
])
#: Tables 3.2 and 3.3: the same, estimated from 4 and from 8 samples.
ESTIMATED = {
    4: np.array([
        8.9468, 1.5728, 2.4259, 4.9358, 6.3033, 5.3359, 6.8490, 4.0711, 6.0960, 1.5999, 1.0508, 2.3435, 3.6165, 4.6088,
        7.1814,
        3.4889, 2.3860, 1.2378, 1.3394, 3.3628, 4.2563, 1.7844, 1.3790, 4.0503, 3.5517, 5.1314, 3.3661, 6.5646, 2.4964,
        5.3204,
    ]),
    8: np.array([
        8.7153, 1.6093, 2.2972, 4.8362, 6.4140, 5.3101, 6.9578, 4.0427, 6.3078, 1.6465, 1.0563, 2.4603, 3.5955, 4.5489,
        7.3629,
        3.3342, 2.3151, 1.2076, 1.3124, 3.3357, 4.2398, 1.7963, 1.3880, 4.1755, 3.6674, 5.2849, 3.4443, 6.6792, 2.5246,
        5.3466,
    ]),
}
#: "RMS Error" below Tables 3.2 and 3.3.
RMS_ERROR = {4: 0.056, 8: 0.035}
#: Table 3.4: natural frequencies (rad/s), actual and from estimated parameters, and their relative difference.
FREQUENCIES = np.array([
    [0.000000, 0.000000, np.nan],
    [0.000000, 0.000000, np.nan],
    [0.064455, 0.064077, -0.005865],
    [0.206939, 0.207273, 0.001614],
    [0.408213, 0.408697, 0.001186],
    [0.719599, 0.719890, 0.004044],
    [1.096452, 1.100486, 0.003679],
    [1.524039, 1.530416, 0.004184],
    [1.999755, 2.007110, 0.003678],
    [2.575960, 2.583589, 0.002962],
])
#: Eqs. (3.19b), times 420 / h, and (3.20b).
MASS_SHAPE = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4.0]])
STIFFNESS_SHAPE = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4.0]])
# fmt: on


def beam(values: FloatArray, damping: dict[str, Any] | None = None) -> Structure:
    """Free-free beam of 15 elements, with nodes 1 to 16 at distances of 1 m.

    `values` (30,) are the masses per length (kg/m) and then the stiffnesses EI / h^3 (N/m); `damping` are damping
    properties of `Beam`, None for a beam without damping.
    """
    nodes = {i + 1: float(i) for i in range(N_ELEMENTS + 1)}
    pairs = [[i, i + 1] for i in range(1, N_ELEMENTS + 1)]
    return Structure(nodes, [Beam("beam", pairs, values[:N_ELEMENTS], values[N_ELEMENTS:], **(damping or {}))])


def unknown_values(structure: Structure, *damping: str) -> Parameters:
    """Parameters of the beam: mass, bending stiffness and the properties `damping` of every element, in this order."""
    names = ("mass", "bending_stiffness", *damping)
    return parameters(structure, [Unknown(name, "beam", each=True, positive=False) for name in names])


def driven(structure: Structure, time: FloatArray, damped: bool = False) -> Motion:
    """Exact motion of the beam from rest under the force 0.1 cos(t) N in Y at node 7, at the instants `time` (n_times,) in s.

    The damping matrix counts only if `damped` is True.
    """
    load = FORCE * structure.selection([Dof(FORCED_NODE, "Y")]).toarray()[:, 0]
    damping = structure.matrix("damping") if damped else None
    transient: Transient = harmonic_transient(
        structure.matrix("mass"), structure.matrix("stiffness"), load, OMEGA, time, damping
    )
    force = np.cos(OMEGA * time)[:, None] * load
    return Motion(time, force, transient.acceleration, transient.velocity, transient.displacement)


def sampling_times(n_samples: int) -> FloatArray:
    """Sampling times (n_samples,) in s: 0.5, 1.0, 1.5 and so on."""
    return STEP * np.arange(1, n_samples + 1)
