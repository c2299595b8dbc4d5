"""
Stress at the foot of a mast, and the damper that lowers it
===========================================================

A mast of 12 m was identified; its bending stiffness is known to 4 %. One learns how large the stress at its foot becomes when the
ground shakes, and which tuned mass damper of 5 kg at its top is best for all the masts that it may be.
"""

# %%
# The identified model: a distribution of structures.

import matplotlib.pyplot as plt
import numpy as np

import structid as sid
from structid.prediction.identified_model import identified_model

lines = [[i, i + 1] for i in range(8)]
mast = sid.Beam("mast", lines, mass=40.0, bending_stiffness=2.4e6, loss_factor=0.01)
structure = sid.Structure({i: 1.5 * i for i in range(9)}, [mast], fixed=["0Y", "0RZ"])
parameters = sid.parameters(structure, [sid.Unknown("bending_stiffness", "mast")])
model = identified_model(structure, parameters, parameters.start, np.array([[(0.04 * 2.4e6) ** 2]]))

# %%
# The foot is shaken for 8 s. The fibre at 0.1 m from the neutral axis has the stress E times its strain; bands hold 95 %.

rate = 200.0
time = np.arange(1600) / rate
shaking = 1.5 * np.sin(2 * np.pi * 2.6 * time) * np.sin(np.pi * time / 8) ** 2
foot = sid.Base("foot", ["0Y"])
history = sid.History(["stress[mast:1@0 y=0.1 E=2.1e11]"], [foot], shaking[:, None], rate)
stress, largest = sid.predict(model, history, n_draws=100), sid.predict(model, sid.Maxima(history), n_draws=200)
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained", width_ratios=(2, 1))
left.fill_between(time, stress.low[:, 0] / 1e6, stress.high[:, 0] / 1e6, alpha=0.3)
left.plot(time, stress.values[:, 0] / 1e6)
left.set(xlabel="time, s", ylabel="stress at the foot, MPa")
right.hist(largest.draws[:, 0] / 1e6, bins=25)
right.set(xlabel="largest stress, MPa", ylabel="models of 200")

# %%
# A damper that is best for the identified mast is tuned too sharply for the others: the one that is best over the uncertainty has
# more damping.

damper = sid.tune_damper(model, "8Y", 5.0)
print(damper)
plt.show()
