"""Structures that their supports drive: against partitioned matrices, differences, and simulated histories."""

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp

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
    TimeFit,
    TimeRecord,
    TimeSetup,
    Unknown,
    identify_together,
    parameters,
)
from structid.forward import (
    SpectraProblem,
    TimeOptions,
    identify_time,
    output_error_problem,
    simulated_time_record,
)
from structid.forward.frf.response import response
from structid.forward.time.options import Oscillation
from structid.inversion.estimate import estimate
from structid.records.spectra import finite_spectra

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
        m, c, k, h = (free.matrix(law).toarray() for law in ("mass", "damping", "stiffness", "structural_damping"))
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
    m, c, k = (structure.matrix(law).toarray() for law in ("mass", "damping", "stiffness"))
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


def columns_on_two_tables() -> Structure:
    """Two columns of two beams with consistent mass, each on a base of its own, one of which drives against its sense."""
    nodes = {s + k: (s / 50, 0.5 * k) for s in (0, 100) for k in range(3)}
    sets = [
        Beam(
            "columns", [[s + k, s + k + 1] for s in (0, 100) for k in range(2)], 3.0, 50.0, 4e3, stiffness_damping=2e-3
        ),
        Bar("ties", [[k, 100 + k] for k in (1, 2)], 2.0, 3e3),
    ]
    bases = [Base("left", ["0X"]), Base("right", ["100X-"])]
    return Structure(nodes, sets, [f"{s}{d}" for s in (0, 100) for d in DIRECT], bases=bases)


MOTIONS = (("2X", "acceleration"), ("102X", "velocity"), ("1X", "displacement"), ("2RZ", "acceleration"))


def tables_record(n_times: int, rng: np.random.Generator, variance=None) -> TimeRecord:
    drive = rng.standard_normal((n_times, 2))
    values = np.concatenate([rng.standard_normal((n_times, len(MOTIONS))), drive], axis=1)
    channels = [*(dof for dof, _ in MOTIONS), "100X-", "0X"]
    kinds = (*(kind for _, kind in MOTIONS), "support_acceleration", "support_acceleration")
    return TimeRecord(60.0, values, channels, kinds, variance=variance)


def integrated(structure: Structure, record: TimeRecord, hold: str) -> np.ndarray:
    """M_ff x'' + C_ff x' + K_ff x = -M_fb a - C_fb v - K_fb d, absolute motion, by Runge and Kutta's eighth order."""
    free = Structure(structure.nodes, structure.elements, (), structure.ties)
    codes = [str(dof.unsigned)[:-1] for dof in free.dofs]
    held = [codes.index(str(dof.unsigned)[:-1]) for dof in structure.fixed]
    own = [i for i in range(len(codes)) if i not in held]
    drive = [codes.index("100X"), codes.index("0X")]
    m, c, k = (free.matrix(law).toarray() for law in ("mass", "damping", "stiffness"))
    inverse = np.linalg.inv(m[np.ix_(own, own)])
    n, step = len(own), 1 / record.sampling_rate
    given = record.values[:, -2:]

    def rates(t, y, now, slope):
        x, v, d, w = y[:n], y[n : 2 * n], y[2 * n : 2 * n + 2], y[2 * n + 2 :]
        a = now + slope * t
        pull = [matrix[np.ix_(own, own)] @ z for matrix, z in ((c, v), (k, x))]
        push = [matrix[np.ix_(own, drive)] @ z for matrix, z in ((m, a), (c, w), (k, d))]
        return np.concatenate([v, -inverse @ (sum(pull) + sum(push)), w, a])

    y, found = np.zeros(2 * n + 4), []
    signed = given * [-1.0, 1.0]  # 100X goes against what 100X- reads
    slopes = np.diff(signed, axis=0, append=signed[-1:]) / step * (hold == "first")
    for now, slope in zip(signed, slopes, strict=True):
        change = rates(0.0, y, now, slope)
        parts = {"displacement": y[:n], "velocity": y[n : 2 * n], "acceleration": change[n : 2 * n]}
        found.append([parts[kind][own.index(codes.index(dof))] for dof, kind in MOTIONS])
        y = solve_ivp(rates, (0.0, step), y, "DOP853", args=(now, slope), rtol=1e-11, atol=1e-13).y[:, -1]
    return np.array(found)


def tables_unknown(structure: Structure):
    return parameters(
        structure,
        [
            Unknown("bending_stiffness", "columns"),
            Unknown("mass", "columns"),
            Unknown("stiffness_damping", "columns"),
            Unknown("axial_stiffness", "ties"),
        ],
    )


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_output_error_moves_as_partitioned_equations_do(hold):
    structure = columns_on_two_tables()
    record = tables_record(40, np.random.default_rng(0), np.full(6, 1e-4) * [1, 1, 1, 1, 0, 0])
    problem = output_error_problem(structure, tables_unknown(structure), record, TimeOptions(force=hold))
    found = problem.model.readings(problem.parameters.start, problem.force, None, 40)
    expected = integrated(structure, record, hold)
    assert (np.abs(found - expected).max(axis=0) <= 1e-7 * np.abs(expected).max(axis=0)).all()
    assert not problem.facts.measures_force


@pytest.mark.parametrize("initial", ["rest", "unknown"])
def test_slopes_of_output_error_are_differences(initial):
    structure = columns_on_two_tables()
    rng = np.random.default_rng(1)
    record = tables_record(60, rng, [1e-2, 1e-4, 1e-6, 1e-1, 0.0, 0.0])
    problem = output_error_problem(structure, tables_unknown(structure), record)
    values = 1.1 * problem.parameters.start
    start = None if initial == "rest" else rng.standard_normal(2 * len(problem.model.free))
    _, slopes = problem.model.derivatives(values, problem.force, start, 60)
    for column, value in enumerate(values):
        step = 1e-5 * value * np.eye(len(values))[column]
        ends = [problem.model.readings(values + sign * step, problem.force, start, 60) for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2e-5 * value)
        assert slopes[..., column] == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("initial", ["rest", "unknown"])
@pytest.mark.parametrize("noise", [0.0, 1e-2])
def test_gradient_of_output_error_is_that_of_its_misfit(initial, noise):
    """With what is solved for inside: errors of the ground's samples, and the state at the start."""
    structure, rng = storeys(2), np.random.default_rng(1)
    unknown = parameters(structure, [Unknown("stiffness", "storeys", each=True), Unknown("viscous_damping", "losses")])
    values = rng.standard_normal((60, 3))
    quantities = ("support_acceleration", "acceleration", "displacement")
    blank = TimeRecord(25.0, values, ["0X", "1X", "2X"], quantities, variance=[noise, 1e-2, 1e-6])
    record = simulated_time_record(structure, unknown, blank, rng=rng)
    problem = output_error_problem(structure, unknown, record, TimeOptions(initial=initial))
    theta = unknown.transforms.free(1.1 * unknown.start)
    gradient = problem.linearize(theta).jacobian.T @ problem.residual(theta)
    for column in range(len(theta)):
        step = 1e-5 * np.eye(len(theta))[column]
        ends = [problem.residual(theta + sign * step) for sign in (1, -1)]
        expected = (ends[0] @ ends[0] - ends[1] @ ends[1]) / 4e-5
        assert gradient[column] == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(gradient).max())


def shaken_from_rest(structure: Structure, ground: np.ndarray, rate: float) -> np.ndarray:
    """Accelerations of the floors of a shear building: z moves with the ground, M z'' + C z' + K z = -M 1 a."""
    m, c, k = (structure.matrix(law).toarray() for law in ("mass", "damping", "stiffness"))
    n, eye = len(m), np.eye(len(m))
    state = np.block([[0 * eye, eye], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
    entry = np.concatenate([np.zeros(n), -np.ones(n)])[:, None]
    reads = -np.linalg.solve(m, np.concatenate([k, c], axis=1))
    system = signal.StateSpace(state, entry, reads, np.zeros((n, 1)))
    return signal.lsim(system, ground, np.arange(len(ground)) / rate, interp=True)[1]


def shaken_record(seed: int, known_ground: bool):
    """A building of two storeys from rest, its record and what is unknown, 10 to 33 % off."""
    structure, rate = storeys(2), 25.0
    rng = np.random.default_rng(seed)
    ground = rng.standard_normal(150)
    values = np.column_stack([ground, shaken_from_rest(structure, ground, rate)])
    noise = np.array([0.0 if known_ground else 0.02, 0.1, 0.1])
    values = values + noise * rng.standard_normal(values.shape)
    quantities = ("support_acceleration", "acceleration", "acceleration")
    record = TimeRecord(rate, values, ["0X", "1X", "2X"], quantities, variance=noise**2)
    unknown = parameters(
        structure,
        [
            Unknown("stiffness", "storeys", each=True, start=2.2e4),
            Unknown("viscous_damping", "losses", start=20.0),
        ],
    )
    return structure, unknown, record


def shaken_fit(seed: int, known_ground: bool):
    return identify_time(*shaken_record(seed, known_ground))


def test_output_error_of_a_shaken_building_as_a_record_among_others():
    setup = TimeSetup(*shaken_record(0, True), TimeFit("output_error"))
    found = identify_together([setup])
    assert np.array_equal(found.estimate.values, shaken_fit(0, True).values)
    assert found.fits[0].used.record.kind == "transmissibility"
    assert not found.problems[0].facts.measures_force
    weak = TimeSetup(*shaken_record(0, True), TimeFit("weak"))
    with pytest.raises(InputError, match="take fit = 'spectra' or 'output_error'"):
        identify_together([weak])


@pytest.mark.parametrize("known_ground", [True, False])
def test_output_error_of_a_shaken_building_gives_stiffnesses_within_their_intervals(known_ground):
    """The mean square of errors over standard deviations is 1, whether the motion of the ground is exact or noisy."""
    errors = []
    for seed in range(24 if known_ground else 6):
        found = shaken_fit(seed, known_ground)
        assert found.status.value == "converged"
        errors.append((found.values - [2e4, 2e4, 30.0]) / found.std)
    assert (np.abs(np.array(errors)) < 4).all()
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (3 * len(errors))))


def test_what_output_error_of_moving_supports_cannot_do_is_named():
    structure = storeys(2)
    unknown = parameters(structure, [Unknown("stiffness", "storeys")])

    def problem(channels, kinds, options=None, where=structure):
        values = np.random.default_rng(0).standard_normal((30, len(channels)))
        record = TimeRecord(25.0, values, channels, kinds, variance=np.full(len(channels), 0.01))
        return record, lambda: output_error_problem(where, unknown, record, options)

    support, motion = "support_acceleration", "acceleration"
    with pytest.raises(InputError, match="take force = 'first' or 'zero'"):
        problem(["0X", "1X"], (support, motion), TimeOptions(force=Oscillation(3.0)))[1]()
    with pytest.raises(InputError, match=r"2X. is a force, and others are motions"):
        problem(["0X", "2X", "1X"], (support, "force", motion))[1]()
    with pytest.raises(InputError, match=r"1X. is no support that drives"):
        problem(["1X", "2X"], (support, motion))[1]()
    record, made = problem(["0X", "1X", "0X"], (support, motion, "displacement"))
    with pytest.raises(InputError, match=r"sensor 0X. moves with the support"):
        made().residual(unknown.theta_start)
    for method in ("weak", "instrumental"):
        with pytest.raises(InputError, match=f"method '{method}' takes no motion of supports; take 'output_error'"):
            identify_time(structure, unknown, record, TimeOptions(method=method))
