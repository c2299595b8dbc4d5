"""The model of a solver's modes: exact at its centre, with their slopes, for close, equal and crossing modes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from structid.core.errors import InputError
from structid.external.modes_model import Tangent, tangent
from structid.external.outputs import RunModes
from structid.external.steps import Pair

N, MODES = 12, 5


def matrices(x, y, split=0.0):
    """A frame-like chain in X and Y with parameters x and y; `split` is how far apart its pairs of modes are."""
    base = 2 * np.eye(N // 2) - np.eye(N // 2, k=1) - np.eye(N // 2, k=-1)
    local = np.diag(np.r_[1.0, np.zeros(N // 2 - 1)])
    stiffness = linalg.block_diag(base + x * local, (1 + split) * base + y * local)
    return np.diag(np.tile(1 + 0.1 * np.arange(N // 2), 2)) + 0.05 * x * np.eye(N), 1e4 * stiffness


def run(x, y, split=0.0, scale=None):
    mass, stiffness = matrices(x, y, split)
    squared, shapes = linalg.eigh(stiffness, mass)
    dofs = np.array([(1 + i % (N // 2), 1 + i // (N // 2)) for i in range(N)])
    values = shapes[:, :MODES] * (1 if scale is None else scale)
    return RunModes(np.sqrt(squared[:MODES]) / (2 * np.pi), dofs, values, scale is None)


def made(x, y, h, split=0.0, scale=None, one_sided=False) -> Tangent:
    steps = (h, 2 * h) if one_sided else (h, -h)
    return tangent(
        "t",
        run(x, y, split, scale),
        [
            Pair("x", steps, tuple(run(x + s, y, split, scale) for s in steps)),
            Pair("y", steps, tuple(run(x, y + s, split, scale) for s in steps)),
        ],
    )


def modes_of(found: Tangent, dx, dy):
    mass, stiffness = (
        table[()] + sum(d**k * table[(name, k),] for name, d in (("x", dx), ("y", dy)) for k in (1, 2))
        for table in (found.mass, found.stiffness)
    )
    squared, shapes = linalg.eigh(stiffness, mass)
    frequency = np.sqrt(np.abs(squared[: found.n_modes])) / (2 * np.pi)
    every = dict(zip(found.masters, shapes, strict=True)) | dict(
        zip(found.tie.dependents, found.tie.matrix @ shapes, strict=True)
    )
    order = sorted(every, key=lambda dof: (dof.direction, dof.node))
    return frequency, np.array([every[dof][: found.n_modes] for dof in order])


@pytest.mark.parametrize("split", [0.3, 1e-3, 0.0])
def test_the_model_has_the_solvers_modes_and_their_slopes(split):
    x, y = 0.7, 0.7
    found = made(x, y, 1e-3, split)
    frequency, shapes = modes_of(found, 0.0, 0.0)
    true = run(x, y, split)
    np.testing.assert_allclose(frequency, true.frequency[: found.n_modes], rtol=1e-10)
    span = np.linalg.qr(true.values[:, : found.n_modes])[0]
    assert np.linalg.norm(shapes - span @ (span.T @ shapes)) < 1e-8
    e = 1e-5
    for dx, dy in ((e, 0.0), (0.0, e)):
        up, down = modes_of(found, dx, dy), modes_of(found, -dx, -dy)
        slope = (run(x + dx, y + dy, split).frequency - run(x - dx, y - dy, split).frequency) / (2 * e)
        if split:  # of equal modes only the sums are smooth
            np.testing.assert_allclose(
                (up[0] - down[0]) / (2 * e), slope[: found.n_modes], rtol=1e-3, atol=1e-3 * abs(slope).max()
            )
        else:
            np.testing.assert_allclose(((up[0] - down[0]) / (2 * e))[:4].sum(), slope[:4].sum(), rtol=1e-3)


@pytest.mark.parametrize("split", [0.3, 0.0])
def test_the_model_has_the_modes_of_every_run_exactly(split):
    x, y, h = 0.7, 0.7, 0.05
    found = made(x, y, h, split)
    for dx, dy in ((h, 0.0), (-h, 0.0), (0.0, h), (0.0, -h)):
        frequency, shapes = modes_of(found, dx, dy)
        true = run(x + dx, y + dy, split)
        np.testing.assert_allclose(frequency, true.frequency[: found.n_modes], rtol=1e-9)
        span = true.values[:, : found.n_modes]
        assert np.linalg.norm(shapes - span @ (np.linalg.pinv(span) @ shapes)) < 1e-6 * np.linalg.norm(shapes)


def test_shapes_have_their_slopes_too():
    x, y, e = 0.7, 0.5, 1e-4
    found = made(x, y, 1e-3, 0.3)
    up, down = modes_of(found, e, 0.0)[1], modes_of(found, -e, 0.0)[1]
    true_up, true_down = run(x + e, y, 0.3).values, run(x - e, y, 0.3).values
    centre = run(x, y, 0.3).values[:, : found.n_modes]
    for own in (up, down, true_up[:, : found.n_modes], true_down[:, : found.n_modes]):
        own *= np.sign(np.einsum("ij,ij->j", own, centre))
    slope = (true_up - true_down)[:, : found.n_modes] / (2 * e)
    np.testing.assert_allclose((up - down) / (2 * e), slope, atol=2e-3 * np.abs(slope).max())


def test_modes_may_cross_between_the_points_of_a_difference():
    x, y = 0.7, 0.7 - 1e-3  # the pairs of split 0 meet at x = y
    found = made(x, y, 4e-3)
    for dx in (-3e-3, 0.0, 3e-3):
        np.testing.assert_allclose(modes_of(found, dx, 0.0)[0], run(x + dx, y).frequency[: found.n_modes], rtol=1e-5)


def test_one_sided_differences_and_shapes_without_scale():
    x, y, e = 0.7, 0.5, 1e-5
    scale = np.array([3.0, 0.2, 1.0, 7.0, 0.5])
    for found in (made(x, y, 1e-3, 0.3, one_sided=True), made(x, y, 1e-3, 0.3, scale)):
        slope = (run(x + e, y, 0.3).frequency - run(x - e, y, 0.3).frequency)[: found.n_modes] / (2 * e)
        own = (modes_of(found, e, 0.0)[0] - modes_of(found, -e, 0.0)[0]) / (2 * e)
        np.testing.assert_allclose(own, slope, rtol=2e-3, atol=1e-3 * abs(slope).max())


def test_fewer_degrees_of_freedom_than_modes_are_refused():
    few = run(0.7, 0.5)
    few = RunModes(few.frequency, few.dofs[:3], few.values[:3], True)
    with pytest.raises(InputError, match="5 modes at 3 degrees of freedom"):
        tangent("t", few, [])
