"""The 27 nonlinear regression problems of NIST's Statistical Reference Datasets, as least-squares problems.

The data, starts and certified values in ``nist_strd.json`` are those of NIST, a work of the US government and in the
public domain. Derivatives are complex steps, exact to rounding.

References
----------
NIST/ITL StRD, https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem

#: Extended precision where there is any: the residuals of Lanczos1 are below the rounding of double precision.
DATA = json.loads((Path(__file__).parent / "nist_strd.json").read_text(), parse_float=np.longdouble)
STEP = 1e-40


def misra1a(b, x):
    return b[0] * (1 - np.exp(-b[1] * x))


def chwirut(b, x):
    return np.exp(-b[0] * x) / (b[1] + b[2] * x)


def lanczos(b, x):
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def gauss(b, x):
    peaks = b[2] * np.exp(-((x - b[3]) ** 2) / b[4] ** 2) + b[5] * np.exp(-((x - b[6]) ** 2) / b[7] ** 2)
    return b[0] * np.exp(-b[1] * x) + peaks


def cubics(b, x):
    return (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3)


def enso(b, x):
    def wave(cosine, sine, period):
        return cosine * np.cos(2 * np.pi * x / period) + sine * np.sin(2 * np.pi * x / period)

    return b[0] + wave(b[1], b[2], 12) + wave(b[4], b[5], b[3]) + wave(b[7], b[8], b[6])


MODELS = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": misra1a,
    "Chwirut1": chwirut,
    "Chwirut2": chwirut,
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": enso,
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": gauss,
    "Gauss2": gauss,
    "Gauss3": gauss,
    "Hahn1": cubics,
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos1": lanczos,
    "Lanczos2": lanczos,
    "Lanczos3": lanczos,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "Misra1a": misra1a,
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** (-2)),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** (-0.5)),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x, z: b[0] - b[1] * x * np.exp(-b[2] * z),
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "Thurber": cubics,
}


@dataclass
class NistProblem(Problem):
    """One problem from one of its two starts; free variables are the parameters themselves, unit weights."""

    name: str
    start: int

    def __post_init__(self):
        own = DATA[self.name]
        self.x = [np.array(x) for x in own["x"]]
        self.y = np.log(own["y"]) if self.name == "Nelson" else np.array(own["y"])
        start = np.array(own[f"start_{self.start}"], dtype=float)
        self.parameters = FreeUnknowns(tuple(f"b{j + 1}" for j in range(len(start))), start)

    @property
    def unknowns(self):
        return self.parameters

    @property
    def rows(self):
        return DataRows(np.arange(len(self.y)), np.zeros(len(self.y), int))

    def residual(self, theta):
        return np.asarray(MODELS[self.name](theta, *self.x) - self.y, dtype=float)

    def linearize(self, theta):
        columns = []
        for j in range(len(theta)):
            moved = np.array(theta, dtype=np.clongdouble)
            moved[j] += 1j * STEP
            columns.append(np.broadcast_to(MODELS[self.name](moved, *self.x).imag / STEP, self.y.shape))
        return Linearization(self.residual(theta), np.stack(columns, axis=1).astype(float))
