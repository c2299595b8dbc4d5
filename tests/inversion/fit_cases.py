"""Fits without a finite element: y = f(x, p) with known noise, each parameter linear, log or between bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem


def straight(x, p):
    return p[0] + p[1] * x


def straight_slope(x, p):
    return np.stack([np.ones_like(x), x], axis=1)


def decay(x, p):
    return p[0] * np.exp(-p[1] * x)


def decay_slope(x, p):
    return np.stack([np.exp(-p[1] * x), -x * p[0] * np.exp(-p[1] * x)], axis=1)


def rise(x, p):
    return p[0] * (1 - np.exp(-p[1] * x))


def rise_slope(x, p):
    return np.stack([1 - np.exp(-p[1] * x), x * p[0] * np.exp(-p[1] * x)], axis=1)


def constant(x, p):
    return np.full_like(x, p[0])


def constant_slope(x, p):
    return np.ones((len(x), 1))


@dataclass(frozen=True, eq=False)
class Transformed(FreeUnknowns):
    """Unknowns with a transform each: "linear", "log" or (low, high)."""

    transform: tuple = ()

    def physical(self, theta):
        return np.array([_physical(t, kind)[0] for t, kind in zip(theta, self.transform, strict=True)])

    def slope(self, theta):
        return np.array([_physical(t, kind)[1] for t, kind in zip(theta, self.transform, strict=True)])


@dataclass
class Case(Problem):
    """`transform`: one of "linear", "log" or (low, high) a parameter."""

    model: object
    derivative: object
    x: np.ndarray
    y: np.ndarray
    start: tuple
    transform: tuple
    sigma: float = 1.0
    channel: np.ndarray = None

    @property
    def unknowns(self):
        start = np.array([_free(p, kind) for p, kind in zip(self.start, self.transform, strict=True)])
        return Transformed(tuple("abcdef"[: len(start)]), start, transform=self.transform)

    @property
    def rows(self):
        channel = np.zeros(len(self.x), int) if self.channel is None else self.channel
        return DataRows(np.arange(len(self.y)), channel)

    def residual(self, theta):
        return (self.model(self.x, self.physical(theta)) - self.y) / self.sigma

    def linearize(self, theta):
        jacobian = self.derivative(self.x, self.physical(theta)) * self.slope(theta) / self.sigma
        return Linearization(self.residual(theta), jacobian)


def _physical(theta, kind):
    if kind == "linear":
        return theta, 1.0
    if kind == "log":
        return np.exp(theta), np.exp(theta)
    part = 0.5 * (1 + np.tanh(0.5 * theta))
    return kind[0] + (kind[1] - kind[0]) * part, (kind[1] - kind[0]) * part * (1 - part)


def _free(p, kind):
    if kind == "linear":
        return float(p)
    if kind == "log":
        return float(np.log(p))
    return float(np.log((p - kind[0]) / (kind[1] - p)))


def line_case(noise, transform=("linear", "linear")):
    x = np.linspace(-1, 1, len(noise))
    return Case(straight, straight_slope, x, straight(x, (2.0, 3.0)) + noise, (1.0, 1.0), transform)


def decay_case(seed, sigma=0.15, transform=("log", "log"), n=15):
    x = np.linspace(0, 2, n)
    noise = sigma * np.random.default_rng(seed).standard_normal(n)
    return Case(decay, decay_slope, x, decay(x, (1.0, 1.0)) + noise, (1.2, 0.8), transform, sigma)


def correlated(seed, n=1000, width=10):
    """Unit-variance noise, correlated over about 3.5 `width` rows."""
    kernel = np.exp(-0.5 * (np.arange(-6 * width, 6 * width + 1) / width) ** 2)
    white = np.random.default_rng(seed).standard_normal(n + len(kernel) - 1)
    return np.convolve(white, kernel, mode="valid") / np.linalg.norm(kernel)
