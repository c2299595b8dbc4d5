"""
A controller for a free beam, designed before and after identification
======================================================================

Norris (1986) identified distributed structures so that large space structures could be controlled. Here a free beam has
two thrusters and, elsewhere, two sensors; a controller (LQG) holds it in place and damps its first bending modes. One learns
that a controller designed on the drawing is unstable on the beam that was built, that the one designed on the identified
model is stable, how to ask for stability over all models within the uncertainty, and why a loop is judged on more modes
than its controller knows.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import block_diag, solve_continuous_are

import structid as sid
from structid.prediction.identified_model import identified_model

NODES = {i: 0.5 * i for i in range(13)}
#: Highest frequency, Hz, and number of states of the models that controllers are designed on, and of those they are judged on.
DESIGN, JUDGED = (100.0, 16), (250.0, 24)
WEIGHT, NOISE = 1e6, 1e-8


def beam(bending_stiffness):
    """Twelve elements of 0.5 m, 2 kg/m, with a little damping."""
    pieces = [[i, i + 1] for i in range(12)]
    element_set = sid.Beam("beam", pieces, mass=2.0, bending_stiffness=bending_stiffness, loss_factor=0.002)
    return sid.Structure(NODES, [element_set])


# %%
# The beam that was built is a quarter softer than its drawing. Its FRFs are measured with 1 % of noise.
drawn, built = beam(4000.0), beam(3000.0)
unknown = [sid.Unknown("bending_stiffness", "beam")]
lines = sid.FrfRecord(
    np.linspace(1.0, 60.0, 300), np.zeros((300, 2, 1), complex), ["0Y", "12Y"], ["0Y"], "accelerance", source="lines"
)
record = sid.simulated_record(built, sid.parameters(built, unknown), lines, 0.01, np.random.default_rng(0))
found = sid.identify(drawn, sid.parameters(drawn, unknown), record)
found.estimate


# %%
# State equations of 16 states hold up to 100 Hz: four of the rigid motions, and six modes. Those on which the loops are
# judged have 24 states, to 250 Hz: a controller also moves the modes that it does not know (spillover, Balas 1978, IEEE
# Trans. Automatic Control 23, 673-679).
def equations(structure, covariance, size):
    parameters = sid.parameters(structure, unknown)
    model = identified_model(structure, parameters, parameters.start, np.array([[covariance]]))
    highest, order = size
    return sid.state_space(model, ["12Y", "3Y"], ["0Y", "7Y"], (0.5, highest), "displacement", order=order)


after, variance = beam(found.estimate.values[0]), found.estimate.covariance[0, 0]
nominal, identified = equations(drawn, 1.0, DESIGN), equations(after, variance, DESIGN)
identified


# %%
# LQG: a regulator that weighs the sensors' motion against the thrust, and a Kalman filter for disturbances at the thrusters.
def regulate(plant):
    """Matrices of the controller from the sensors to the thrusters."""
    cost = solve_continuous_are(plant.a, plant.b, WEIGHT * plant.c.T @ plant.c, np.eye(2))
    spread = solve_continuous_are(plant.a.T, plant.c.T, plant.b @ plant.b.T, NOISE * np.eye(2))
    gain, filter_gain = plant.b.T @ cost, spread @ plant.c.T / NOISE
    return plant.a - plant.b @ gain - filter_gain @ (plant.c - plant.d @ gain), filter_gain, -gain


def slowest(plant, controller):
    """Largest real part of the poles of the closed loop, 1/s: negative where it is stable."""
    a, b, c = controller
    loop = block_diag(plant.a, a + b @ plant.d @ c)
    n = len(plant.a)
    loop[:n, n:] = plant.b @ c
    loop[n:, :n] = b @ plant.c
    return np.linalg.eigvals(loop).real.max()


truth = equations(built, 1.0, JUDGED)
few = equations(after, variance, (40.0, 10))
designs = {
    "on the drawing": nominal,
    "on the identified model": identified,
    "on its three modes below 40 Hz alone": few,
}
for words, design in designs.items():
    pole = slowest(truth, regulate(design))
    print(f"designed {words}: slowest pole of the built beam {pole:+.2f} 1/s, {'stable' if pole < 0 else 'unstable'}")

# %%
# Stability over the posterior: the same controller on a hundred models within the uncertainty.
std = found.estimate.std[0]
draws = found.estimate.values[0] + std * np.random.default_rng(1).standard_normal(100)
models = [equations(beam(value), 1.0, JUDGED) for value in draws]
poles = np.array([slowest(model, regulate(identified)) for model in models])
print(f"stable on {np.sum(poles < 0)} of 100 models within the uncertainty")

figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
stiffness = np.linspace(0.6, 1.5, 46) * 3000
plants = [equations(beam(value), 1.0, JUDGED) for value in stiffness]
for words in ("on the drawing", "on the identified model"):
    controller = regulate(designs[words])
    axes.plot(stiffness, [slowest(plant, controller) for plant in plants], label=f"designed {words}")
axes.axhline(0, color="0.6", linewidth=0.8)
for value, words in ((3000, "built"), (4000, "drawn")):
    axes.axvline(value, color="0.6", linewidth=0.8, linestyle=":")
    axes.text(value, 0.98, f" {words}", transform=axes.get_xaxis_transform(), va="top", color="0.4")
axes.set(xlabel="bending stiffness of the beam (N m²)", ylabel="slowest pole (1/s), stable below 0")
figure.legend(loc="outside upper center", ncols=2, frameon=False)
