"""
NIST's regression problems: the estimator by itself
===================================================

The searches know no finite element: any residual with a Jacobian will do. Here one of the problems of NIST's
Statistical Reference Datasets (Misra1a, in the public domain), whose values are certified to eleven digits. One
learns how to bring a problem of one's own, and that the search ends where it should.
"""

import numpy as np
from matplotlib.figure import Figure

import structid as sid
from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem

X = np.array([77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0])
Y = np.array([10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78])


class Misra1a(Problem):
    """y = b1 (1 - exp(-b2 x)) with unit weights; the free variables are b1 and b2 themselves."""

    unknowns = FreeUnknowns(("b1", "b2"), np.array([500.0, 1e-4]))
    rows = DataRows(np.arange(len(X)), np.zeros(len(X), int))

    def residual(self, theta):
        """Model less data."""
        return theta[0] * (1 - np.exp(-theta[1] * X)) - Y

    def linearize(self, theta):
        """The residual with its Jacobian."""
        decay = np.exp(-theta[1] * X)
        return Linearization(self.residual(theta), np.stack([1 - decay, theta[0] * X * decay], axis=1))


# %%
# Found and certified
# -------------------
found = sid.estimate(Misra1a())
certified = np.array([238.94212918, 5.5015643181e-4])
print(found.message)
for name, value, right in zip(found.names, found.values, certified, strict=True):
    print(f"{name}: {value:.10g}, certified {right:.11g}, relative difference {abs(value / right - 1):.1e}")

figure = Figure(figsize=(7, 3), layout="constrained")
axes = figure.subplots()
axes.plot(X, Y, "ko", ms=4, label="data of NIST")
fine = np.linspace(0, 800, 200)
axes.plot(fine, found.values[0] * (1 - np.exp(-found.values[1] * fine)), label="b1 (1 - exp(-b2 x))")
axes.set_xlabel("x")
axes.set_ylabel("y")
axes.legend(frameon=False)
