"""
Springs, a dashpot and dry friction
===================================

A mass on a spring slides on a rail that has an oil film and dry friction. In a response, friction counts per newton
of the force that shakes: four times the force, a quarter of the friction, while the oil film stays. One learns to
tell the two by records at two levels of the force, which one level alone would not.
"""

import numpy as np

import structid as sid


def slider(friction, oil, stiffness, drive):
    """Two masses; the first slides."""
    parts = [
        sid.PointMass("mass", [1, 2], [2.0, 1.0]),
        sid.Spring("spring", ["0X", "1X"], ["1X", "2X"], stiffness=stiffness),
        sid.Dashpot("oil", "1X", viscous_damping=oil),
        sid.Friction(f"rail, {drive} N", "1X", friction_force=friction / drive),
    ]
    return sid.Structure({0: 0.0, 1: 1.0, 2: 2.0}, parts, ["0X"], active=["X"])


lines = np.arange(2.0, 25.0, 0.05)
like = sid.FrfRecord(lines, np.ones((len(lines), 2, 1)), ("1X", "2X"), ("2X",), "accelerance")
rng = np.random.default_rng(1)
setups = []
for drive in (5, 20):
    truth, model = slider(1.0, 6.0, [8e3, 5e3], drive), slider(0.6, 10.0, [7e3, 6e3], drive)
    record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, rng)
    unknown = [
        sid.Unknown("stiffness", "spring", each=True),
        sid.Unknown("viscous_damping", "oil"),
        sid.Unknown("friction_force", f"rail, {drive} N"),
    ]
    setups.append(sid.Setup(model, sid.parameters(model, unknown), record, name=f"{drive} N"))

# %%
# The answer from both levels: 1 N of friction is 0.2 N/N at 5 N and 0.05 N/N at 20 N
# ------------------------------------------------------------------------------------
found = sid.identify_together(setups)
print(found.estimate)
weak = found.plot_frf("1X", "2X", record=0)
strong = found.plot_frf("1X", "2X", record=1)
