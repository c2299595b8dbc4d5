"""Structures that their supports drive: against partitioned matrices, differences, and simulated histories."""

import numpy as np
import pytest

from structid import (
    Bar,
    Base,
    Beam,
    Dashpot,
    FrfRecord,
    InputError,
    PointMass,
    RigidLink,
    Spring,
    Structure,
    TimeRecord,
    Unknown,
    parameters,
)
from structid.estimation import estimate
from structid.observation import SpectraProblem
from structid.observation.frf.response import response
from structid.records.transforms.finite_spectra import finite_spectra

DIRECT = ("X", "Y", "RZ")


TABLE = (Base("table", ["0X", "100X"]),)


def frame(n: int, bases=TABLE) -> Structure:
    """Two columns of n beams joined by bars, on two supports."""
    nodes = {s + k: (s / 50, 0.5 * k) for s in (0, 100) for k in range(n + 1)}
    columns = [[s + k, s + k + 1] for s in (0, 100) for k in range(n)]
    sets = [
        Beam("columns", columns, 3.0, 50.0, 4e3, stiffness_damping=0.02, loss_factor=0.01, shear_stiffness=900.0),
        Bar("ties", [[k, 100 + k] for k in range(1, n + 1)], 2.0, 3e3),
        PointMass("masses", list(range(1, n + 1)), 5.0),
    ]
    return Structure(nodes, sets, [f"{s}{d}" for s in (0, 100) for d in DIRECT], bases=bases)


def partitioned(structure: Structure, moved: list[str], frequency: np.ndarray, sensors: list[str]) -> np.ndarray:
    """T = S' (-Z_ff^-1 Z_fb) sum of the columns of the moved supports, dense."""
    free = Structure(structure.nodes, structure.elements, (), structure.ties)
    codes = [str(dof.unsigned)[:-1] for dof in free.dofs]
    held = [codes.index(str(dof.unsigned)[:-1]) for dof in structure.fixed]
    own = [i for i in range(len(codes)) if i not in held]
    drive = [codes.index(name) for name in moved]
    reads = [own.index(codes.index(name)) for name in sensors]
    found = []
    for f in frequency:
        s = 2j * np.pi * f
        m, c, k, h = (free.matrix(law).toarray() for law in ("inertia", "viscous", "elastic", "structural"))
        z = s**2 * m + s * c + k + 1j * h
        found.append(-np.linalg.solve(z[np.ix_(own, own)], z[np.ix_(own, drive)].sum(axis=1))[reads])
    return np.array(found)


def unknowns(structure: Structure):
    return parameters(
        structure,
        [
            Unknown("bending_stiffness", "columns"),
            Unknown("shear_stiffness", "columns"),
            Unknown("mass", "masses"),
            Unknown("stiffness_damping", "columns"),
            Unknown("axial_stiffness", "ties"),
        ],
    )


@pytest.mark.parametrize("n", [2, 20])
def test_transmissibility_is_that_of_partitioned_matrices(n):
    structure, sensors = frame(n), [f"{n}X", f"{100 + n}Y", "1X"]
    frequency = np.linspace(0.2, 9.0, 6)
    like = FrfRecord(frequency, np.ones((6, 3, 1)), sensors, ["100X"], "transmissibility")
    found = response(structure, unknowns(structure), like).values_at(np.array(unknowns(structure).start))
    expected = partitioned(structure, ["0X", "100X"], frequency, sensors)
    assert np.abs(found[:, :, 0] - expected).max() <= 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("n", [2, 20])
def test_derivatives_are_differences(n):
    structure = frame(n, (Base("left", "0X"), Base("right", ["100X", "100Y-"])))
    unknown = unknowns(structure)
    frequency = np.linspace(0.2, 9.0, 5) / (n / 2) ** 1.5
    like = FrfRecord(frequency, np.ones((5, 2, 2)), [f"{n}X", f"{100 + n}Y-"], ["0X", "100X-"], "transmissibility")
    model, start = response(structure, unknown, like), np.array(unknown.start)
    values, slopes = model.derivatives_at(start)
    assert np.abs(values - model.values_at(start)).max() <= 1e-10 * np.abs(values).max()
    left = partitioned(structure, ["0X"], frequency, [f"{n}X"])
    assert np.abs(values[:, 0, 0] - left[:, 0]).max() <= 1e-8 * np.abs(values).max()
    for k, step in enumerate(1e-3 * start):
        move = step * np.eye(len(start))[k]
        near, far = (model.values_at(start + m * move) - model.values_at(start - m * move) for m in (1, 2))
        difference = (8 * near - far) / (12 * step)
        error = start[k] * np.abs(slopes[..., k] - difference)
        assert error.max() <= 1e-7 * np.abs(slopes * start).max()
        assert error.max() <= 1e-4 * start[k] * np.abs(difference).max()


def test_a_table_that_carries_the_supports_by_a_rigid_link_drives_as_they_do():
    plain = frame(2)
    nodes = {**plain.nodes, 300: (1.0, -0.2)}
    linked = Structure(
        nodes,
        plain.elements,
        ["300X", "300Y", "300RZ"],
        [RigidLink("feet", 300, [0, 100])],
        bases=[Base("table", "300X")],
    )
    frequency, ones = np.linspace(0.2, 9.0, 5), np.ones((5, 1, 1))
    found = []
    for structure, at in ((plain, "0X"), (linked, "300X")):
        like = FrfRecord(frequency, ones, ["2X"], [at], "transmissibility")
        found.append(response(structure, unknowns(structure), like).values_at(np.array(unknowns(structure).start)))
    assert found[1] == pytest.approx(found[0], rel=1e-8)


def test_no_common_factor_of_masses_and_stiffnesses_is_seen():
    structure = frame(3)
    unknown = parameters(
        structure,
        [Unknown(p, "columns") for p in ("mass", "bending_stiffness", "shear_stiffness", "axial_stiffness")]
        + [
            Unknown("stiffness_damping", "columns"),
            Unknown("mass", "masses"),
            Unknown("mass", "ties", name="bars"),
            Unknown("axial_stiffness", "ties"),
        ],
    )
    like = FrfRecord(np.linspace(0.2, 9.0, 5), np.ones((5, 2, 1)), ["2X", "3X"], ["0X"], "transmissibility")
    start = np.array(unknown.start)
    _, slopes = response(structure, unknown, like).derivatives_at(start)
    assert np.abs(slopes @ start).max() <= 1e-9 * np.abs(slopes * start).max()


def storeys(n: int = 3) -> Structure:
    """A shear building: masses, springs and dashpots in a line, no mass at the ground."""
    below, above = [f"{k}X" for k in range(n)], [f"{k + 1}X" for k in range(n)]
    sets = [
        PointMass("floors", list(range(1, n + 1)), 10.0),
        Spring("storeys", below, above, stiffness=2e4),
        Dashpot("losses", below, above, viscous_damping=30.0),
    ]
    return Structure(dict.fromkeys(range(n + 1), 0.0), sets, ["0X"], active=["X"], bases=[Base("ground", "0X")])


def shaken(structure: Structure, rate: float, n_times: int, rng: np.random.Generator) -> np.ndarray:
    """Accelerations of the ground, noise below 0.4 of the rate, and of the floors: (n_times, 1 + n), in motion at both ends.

    A stretch of a periodic motion three times as long: M z'' + C z' + K z = -M 1 a, where z moves with the ground.
    """
    lines = np.fft.rfftfreq(3 * n_times, 1 / rate)
    ground = np.exp(2j * np.pi * rng.random(len(lines))) * ((lines < 0.4 * rate) & (lines > 0))
    m, c, k = (structure.matrix(law).toarray() for law in ("inertia", "viscous", "elastic"))
    s = 2j * np.pi * lines[:, None, None]
    relative = np.linalg.solve(s**2 * m + s * c + k, np.tile(-m.sum(axis=1)[:, None], (len(lines), 1, 1)))[..., 0]
    spectra = ground[:, None] * np.column_stack([np.ones(len(lines)), 1 + s[..., 0] ** 2 * relative])
    values = np.fft.irfft(spectra, 3 * n_times, axis=0)
    return values[n_times : 2 * n_times] / values[:, 0].std()


def shaken_problem(structure: Structure, seed: int, n_times: int = 1024, rate: float = 25.0) -> SpectraProblem:
    """Stiffness and damping of each storey from noisy accelerations of ground and floors."""
    rng = np.random.default_rng(seed)
    values = shaken(structure, rate, n_times, rng)
    noise = 0.05 * values.std(axis=0)
    noise[0] *= 0.2
    values = values + noise * rng.standard_normal(values.shape)
    n = values.shape[1]
    quantities = ("support_acceleration", *["acceleration"] * (n - 1))
    record = TimeRecord(rate, values, [f"{k}X" for k in range(n)], quantities, variance=noise**2)
    unknown = parameters(
        structure,
        [
            Unknown("stiffness", "storeys", each=True, start=2.4e4),
            Unknown("viscous_damping", "losses", start=20.0),
        ],
    )
    return SpectraProblem(structure, unknown, finite_spectra(record, band=(0.3, 10.0)), record=record)


def test_histories_of_a_shaken_building_give_stiffnesses_within_their_intervals():
    """24 records that start and end in motion; the mean square of errors over standard deviations is 1."""
    errors = []
    for seed in range(24):
        found = estimate(shaken_problem(storeys(), seed))
        assert found.status.value == "converged"
        errors.append((found.values - [2e4, 2e4, 2e4, 30.0]) / found.std)
    assert (np.abs(np.array(errors)) < 4).all()
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (24 * 4)))


def test_slopes_of_the_histories_are_differences():
    problem = shaken_problem(storeys(), 1)
    theta = problem.theta_start
    jacobian = problem.linearize(theta).jacobian
    # the Jacobian of a variable projection is exact in the gradient, see `SpectraProblem`
    gradient = jacobian.T @ problem.linearize(theta).residual
    for k in range(len(theta)):
        move = 1e-5 * np.eye(len(theta))[k]
        ends = [0.5 * np.sum(problem.residual(theta + sign * move) ** 2) for sign in (1, -1)]
        assert gradient[k] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4)


@pytest.mark.parametrize(
    ("bases", "inputs", "kind", "words"),
    [
        ([Base("table", "3X")], ["0X"], "transmissibility", "base 'table' has no support 3X: it is not held"),
        ([Base("table", "0Z")], ["0X"], "transmissibility", "base 'table' moves nothing at 0Z"),
        ([], ["0X"], "transmissibility", r"input 0X\+ is none; make it a support"),
        ([], ["0X"], "accelerance", "held at zero by the supports.*make it a support of a base"),
        (
            [Base("table", "0X")],
            ["0X"],
            "accelerance",
            "support of base 'table'.*read it with kind = 'transmissibility'",
        ),
        ([Base("table", "0X")], ["0X", "1X"], "transmissibility", r"1X\+ is a force, and others are motions"),
        ([Base("table", ["0X", "100X"])], ["0X", "100X"], "transmissibility", "two inputs move base 'table'"),
        ([Base("a", "0X"), Base("b", "0X")], ["0X"], "transmissibility", "0X, which is named twice"),
    ],
)
def test_what_cannot_be_driven_is_named(bases, inputs, kind, words):
    plain = frame(2, ())
    fixed = [*plain.fixed, "0Z"]
    like = FrfRecord([1.0, 2.0], np.ones((2, 1, len(inputs))), ["2X"], inputs, kind)

    def driven():
        structure = Structure(plain.nodes, plain.elements, fixed, bases=bases)
        return response(structure, unknowns(structure), like)

    with pytest.raises(InputError, match=words):
        driven()


def test_a_sensor_on_the_support_is_refused():
    like = FrfRecord([1.0, 2.0], np.ones((2, 2, 1)), ["2X", "100X"], ["0X"], "transmissibility")
    structure = frame(2)
    with pytest.raises(InputError, match=r"sensor 100X\+ moves with the support"):
        response(structure, unknowns(structure), like)
