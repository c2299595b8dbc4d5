"""
Axial force: the tension of a tie rod from its frequencies
==========================================================

A rod of 24 mm ties two walls 6 m apart. Its tension stiffens it sideways, and five frequencies tell it, if what holds
the ends is known: pinned ends here. One learns how the tension enters, what the uncertainty of the diameter does to it, and what
happens at the buckling load.
"""

import numpy as np

import structid as sid
from structid.dynamics.normal_modes import modes

LENGTH, MASS, BENDING, TENSION = 6.0, 3.55, 3.34e3, 40e3
k = np.pi * np.arange(1, 6) / LENGTH
exact = np.sqrt((BENDING * k**4 + TENSION * k**2) / MASS) / (2 * np.pi)
measured = exact * (1 + 0.001 * np.random.default_rng(4).standard_normal(5))


def rod(tension):
    """One beam, cut into 24 pieces, between two pins."""
    beam = sid.Beam("rod", [[0, 1]], MASS, 3e3, axial_force=tension)
    return sid.Structure({0: 0.0, 1: LENGTH}, [beam], fixed=["0Y", "1Y"], subdivide=24)


# %%
# Tension and bending stiffness from five frequencies
# ---------------------------------------------------
# The file of a test would say the frequencies; their errors are 0.1 %. The mass per length is held, and known to 1 % unless stated
# otherwise: the tension can be known no better than that, since only its ratio to the mass moves a frequency.
record = sid.ModalRecord(measured, np.full(5, np.nan), np.full((1, 5), np.nan), ("0RZ",))
start = rod(25e3)
unknown = sid.parameters(start, [sid.Unknown("axial_force", "rod"), sid.Unknown("bending_stiffness", "rod")])
setup = sid.ModalSetup(start, unknown, record, sid.ModalSettings(frequency_error=0.001))
found = sid.identify_together([setup])
print(found.estimate)
print(found.assumption)
print(f"of the frequencies alone: ± {found.estimate.std_noise[0]:.3g} N")

# %%
# In compression
# --------------
# The same element is a column: its lowest frequency falls to zero at Euler's load.
euler = np.pi**2 * 3e3 / LENGTH**2
for part in (0.0, 0.5, 0.9, 0.99):
    column = rod(-part * euler)
    lowest = modes(column.matrix("mass"), column.matrix("stiffness"), n_modes=1).frequency[0]
    print(f"{part:4.2f} of {euler:.1f} N: {lowest:.4f} Hz")
