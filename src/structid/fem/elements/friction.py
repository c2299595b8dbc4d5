"""Dry friction to the ground, linearized at the amplitude that was measured."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.constraints import Number
from structid.fem.elements.connector import Connector, dofs_stored
from structid.fem.elements.element import End, Ends, OtherEnd, Values, declared, element


@element
class Friction(Connector):
    """Dry (Coulomb) friction between one degree of freedom and another or the ground, by harmonic linearization.

    A friction force of constant amplitude, in phase with the sliding velocity, has the dynamic stiffness
    i r / \\|x\\|, where r is the amplitude of its first harmonic per unit of drive amplitude and \\|x\\| the sliding
    amplitude per unit drive: the model's own, by harmonic balance. It holds while the drive amplitude is the same at
    all frequencies and one load acts at a time. Where r exceeds the force that reaches the contact, it sticks.

    References
    ----------
    Den Hartog (1931), Trans. ASME 53, APM-53-9; Magnus, Popp, Sextro (2016), Schwingungen, section 3.2.
    """

    symbol = "friction"

    first: End = declared("Where the friction acts")
    second: OtherEnd = declared("The other end; the ground where left out", default=None)
    friction_force: Values = declared(
        "First harmonic of the force per unit of drive: 4/pi times the sliding force over the amplitude of the load",
        "friction",
        "N/N",
        kw_only=True,
    )
    measured_by: Ends = declared(
        "Sensors whose mean along their axes is the sliding motion. Searches from poor starts take the amplitude from them,"
        " which keeps the model linear; the last stage takes the model's own",
        stored=dofs_stored,
        default=(),
        kw_only=True,
    )
    smoothing: Number = declared(
        "Neighbouring lines over which a measured amplitude is averaged (geometric mean); 1 for none",
        stored=lambda name, given: max(1, int(given)),
        default=1,
        kw_only=True,
    )

    def sliding(self, receptance: np.ndarray) -> FloatArray:
        """Smoothed sliding amplitude, (n_frequencies,), from measured receptances of the `measured_by` sensors.

        It is the size of their mean, averaged geometrically over `smoothing` lines, per unit of load.

        Parameters
        ----------
        receptance : (n_frequencies, n_sensors) complex array
            Signs of the sensors already removed.
        """
        size = np.log(np.maximum(np.abs(receptance.mean(axis=1)), np.finfo(float).tiny))
        window = np.ones(min(self.smoothing, len(size)))
        total = np.convolve(size, window, mode="same")
        return np.exp(total / np.convolve(np.ones(len(size)), window, mode="same"))
