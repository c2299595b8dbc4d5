"""The pseudo-Rayleigh quotient on structures of its own: exactness, invariance, shapes, warnings and bad input."""

import numpy as np
import pytest

from structid import InputError, PointMass, SpaceBeam, Structure, TimeRecord
from structid.core.dof import Dof
from structid.dynamics.normal_modes import modes
from structid.dynamics.transient import free_decay
from structid.fem import Membrane
from structid.modal import ModalRecord, stationary_values
from structid.modal.rayleigh import _omega, _real_where_close, pseudo_rayleigh, sample_weights
from structid.reproduce.chapter_5 import free_record
from structid.similarity import mac, subspace_angles

OMEGA = np.array([2.0, 3.1, 4.5, 7.0])
EXACT = {
    "exact": "displacement-acceleration",
    "end_corrected": "displacement-velocity",
    "second_difference": "displacement",
}
PRINTED = {"as_printed": "displacement-velocity", "symmetric_acceleration": "displacement-acceleration"}


def record_of(omega, shapes, duration=10.0, step=0.02, dofs=None, **start):
    time = np.arange(round(duration / step) + 1) * step
    start = start or {"displacement": np.linspace(1.0, 0.5, len(omega)), "velocity": np.linspace(-1.0, 1.0, len(omega))}
    places = dofs or [Dof(i + 1, "Z") for i in range(len(shapes))]
    return free_record(free_decay(omega, shapes, time, **start), step, places, "test")


def random_shapes(n_channels, n_modes=4, seed=3):
    return np.random.default_rng(seed).standard_normal((n_channels, n_modes))


def likeness(found, shapes):
    return np.diag(mac(found.mode_shapes, shapes))


# ---- simulated motion


def test_free_decay_solves_its_equation_of_motion():
    """Differences of step 1e-4 are good to 1e-8 relative; the equation itself to rounding."""
    omega, ratio, time = np.array([0.0, 3.0]), np.array([0.0, 0.1]), np.linspace(0.5, 2, 7)
    start = {"displacement": np.array([0.4, -0.7]), "velocity": np.array([0.3, 2.0]), "damping_ratio": ratio}
    u, v, a = free_decay(omega, np.eye(2), time, **start)
    assert a + 2 * ratio * omega * v + omega**2 * u == pytest.approx(np.zeros((7, 2)), abs=1e-13)
    later, earlier = (free_decay(omega, np.eye(2), time + h, **start) for h in (1e-4, -1e-4))
    assert (later.displacement - earlier.displacement) / 2e-4 == pytest.approx(v, abs=1e-6)
    assert (later.velocity - earlier.velocity) / 2e-4 == pytest.approx(a, abs=1e-6)
    at_rest = free_decay(omega, np.eye(2), np.zeros(1), **start)
    assert at_rest.displacement[0] == pytest.approx(start["displacement"])
    assert at_rest.velocity[0] == pytest.approx(start["velocity"])


# ---- quadrature


@pytest.mark.parametrize(("rule", "degree"), [("trapezoid", 1), ("gregory", 7)])
def test_rules_integrate_polynomials_of_their_degree(rule, degree):
    t = np.linspace(0, 1, 31)
    for power in range(degree + 1):
        assert sample_weights(31, rule) @ t**power == pytest.approx(1 / (power + 1), rel=1e-13)
    assert sample_weights(31, rule) @ t ** (degree + 3) != pytest.approx(1 / (degree + 4), rel=1e-13)


def test_rectangle_rules_take_the_samples_they_name():
    assert sample_weights(5, "left") == pytest.approx(np.array([1, 1, 1, 1, 0]) / 4)
    assert sample_weights(5, "interior") == pytest.approx(np.array([0, 1, 1, 1, 0]) / 4)
    assert (sample_weights(400, "gregory") > 0).all()


# ---- exact forms


@pytest.mark.parametrize("form", EXACT)
@pytest.mark.parametrize("duration", [3.0, 10.0, 57.3])
def test_exact_forms_hold_for_any_duration(form, duration):
    """1e-10: rounding times the condition of the response; quadrature of `gregory` at omega h = 0.07 is below it."""
    shapes = random_shapes(4)
    step = 0.01 if form == "end_corrected" else 0.05
    found = pseudo_rayleigh(record_of(OMEGA, shapes, duration, step), EXACT[form], form)
    assert np.abs(found.omega / OMEGA - 1).max() <= 1e-10
    assert (1 - likeness(found, shapes)).max() <= 1e-10
    assert np.isnan(found.damping_ratio).all()


@pytest.mark.parametrize("form", ["exact", "end_corrected", "second_difference"])
def test_exact_forms_reduce_more_channels_than_modes(form):
    shapes = random_shapes(9)
    found = pseudo_rayleigh(record_of(OMEGA, shapes, 8.0, 0.01), EXACT[form], form)
    assert np.abs(found.omega / OMEGA - 1).max() <= 1e-10
    assert (1 - likeness(found, shapes)).max() <= 1e-10
    assert any("9 channels reduced to 4" in note for note in found.warnings)


def test_second_difference_is_exact_for_coarse_samples():
    """omega h = 2.8 of the highest mode: 2.2 samples a period."""
    found = pseudo_rayleigh(record_of(OMEGA, random_shapes(4), 30.0, 0.4), "displacement", "second_difference")
    assert np.abs(found.omega / OMEGA - 1).max() <= 1e-10
    uncorrected = stationary_values(record_of(OMEGA, random_shapes(4), 30.0, 0.4), "displacement", "second_difference")
    assert uncorrected.eigenvalues == pytest.approx((2 / 0.4 * np.sin(0.2 * OMEGA)) ** 2, rel=1e-10)


@pytest.mark.parametrize("pair", ["velocity", "acceleration"])
def test_second_difference_takes_any_quantity(pair):
    found = pseudo_rayleigh(record_of(OMEGA, random_shapes(4)), pair, "second_difference")
    assert np.abs(found.omega / OMEGA - 1).max() <= 1e-10


def test_printed_forms_converge_as_their_order_says():
    """Largest error over durations of T to 1.3 T: of order 1/T and 1/T^2."""
    errors = {form: [] for form in PRINTED}
    for duration in (40.0, 400.0):
        for form, pair in PRINTED.items():
            cases = [
                pseudo_rayleigh(record_of(OMEGA, np.eye(4), duration * s, 0.08), pair, form, "gregory").omega / OMEGA
                - 1
                for s in np.linspace(1, 1.3, 9)
            ]
            errors[form].append(np.sqrt(np.mean(np.square(cases))))
    slope = {form: np.log10(e[0] / e[1]) for form, e in errors.items()}
    assert slope["as_printed"] == pytest.approx(1.0, abs=0.15)
    assert slope["symmetric_acceleration"] == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("form", PRINTED)
def test_eigenvalues_do_not_depend_on_shapes_nor_on_channels(form):
    """Biased as they are, they belong to the frequencies, the phases, T and the quadrature alone."""
    first, *others = (
        stationary_values(record_of(OMEGA, random_shapes(n, seed=n), 12.0), PRINTED[form], form, rule="left")
        for n in (4, 5, 8)
    )
    assert np.abs(first.eigenvalues / OMEGA**2 - 1).max() > 1e-3
    for other in others:
        assert other.eigenvalues == pytest.approx(first.eigenvalues, rel=1e-9)


def test_printed_forms_are_the_quotient_of_the_averages():
    """A and B written out as sums over samples 1..N-1, and the dense generalized eigenvalue problem."""
    record = record_of(OMEGA, random_shapes(4))
    u, v, a = (record.values[1:-1, 4 * k : 4 * k + 4] for k in range(3))
    gram = u.T @ u
    for form, b in (("as_printed", v.T @ v), ("symmetric_acceleration", -0.5 * (a.T @ u + u.T @ a))):
        found = stationary_values(record, PRINTED[form], form, rule="interior")
        expected = np.sort(np.linalg.eigvals(np.linalg.solve(gram, b)).real)
        assert found.eigenvalues == pytest.approx(expected, rel=1e-10)
        quotient = [(x @ b @ x) / (x @ gram @ x) for x in found.vectors.T]
        assert quotient == pytest.approx(found.eigenvalues, rel=1e-10)


# ---- mode shapes


def chain(masses):
    """Masses in a row between springs of 1000 N/m, as M, K."""
    n = len(masses)
    return np.diag(masses), 1000.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))


def chain_modes(masses):
    mass, stiffness = chain(masses)
    values, vectors = np.linalg.eigh(stiffness / np.sqrt(np.outer(masses, masses)))
    return mass, np.sqrt(values), vectors / np.sqrt(masses)[:, None]


def test_shapes_need_no_mass_and_vectors_carry_it():
    masses = np.array([0.5, 3.0, 1.0, 2.0, 0.7, 2.5])
    mass, omega, shapes = chain_modes(masses)
    record = record_of(omega, shapes, 40.0, 0.005, velocity=shapes[0])
    found = stationary_values(record, "displacement-velocity", "as_printed")
    assert np.diag(mac(found.mode_shapes, shapes)).min() >= 0.999
    assert np.diag(mac(found.vectors, mass @ shapes)).min() >= 0.999
    assert np.diag(mac(found.vectors, shapes)).max() <= 0.97
    assert found.vectors.T @ found.mode_shapes == pytest.approx(np.eye(6), abs=1e-9)
    exact = stationary_values(record, "displacement-acceleration", "exact")
    assert np.diag(mac(exact.vectors, mass @ shapes)) == pytest.approx(np.ones(6), abs=1e-10)


@pytest.mark.parametrize("consistent", [False, True])
def test_mass_gives_the_shapes_of_the_dissertation(consistent):
    masses = np.array([0.5, 3.0, 1.0, 2.0])
    mass, omega, shapes = chain_modes(masses)
    record = record_of(omega, shapes, 20.0, 0.01, velocity=shapes[0])
    given = mass if consistent else masses
    plain = pseudo_rayleigh(record, "displacement-acceleration", "exact")
    by_mass = pseudo_rayleigh(record, "displacement-acceleration", "exact", mass=given)
    assert likeness(by_mass, shapes) == pytest.approx(np.ones(4), abs=1e-10)
    assert likeness(by_mass, plain.mode_shapes) == pytest.approx(np.ones(4), abs=1e-10)
    printed = stationary_values(record, "displacement-velocity", "as_printed")
    expected = np.linalg.solve(mass, printed.vectors)
    found = pseudo_rayleigh(record, "displacement-velocity", "as_printed", mass=given)
    assert likeness(found, expected) == pytest.approx(np.ones(4), abs=1e-10)


def test_shapes_of_translations_and_rotations_do_not_depend_on_units():
    """Rotations a million times smaller than displacements still count as motion."""
    shapes = random_shapes(4)
    dofs = [Dof(1, "Z"), Dof(2, "Z"), Dof(1, "RX"), Dof(2, "RX")]
    shapes[2:] *= 1e-7
    found = pseudo_rayleigh(record_of(OMEGA, shapes, dofs=dofs), "displacement-acceleration", "exact")
    assert np.abs(found.omega / OMEGA - 1).max() <= 1e-10


def test_rigid_body_modes_take_velocity_and_acceleration():
    omega, shapes = np.append(0.0, OMEGA), random_shapes(5, 5)
    record = record_of(omega, shapes, 12.0, 0.01)
    for form in ("as_printed", "end_corrected"):
        found = pseudo_rayleigh(record, "velocity-acceleration", form)
        assert found.omega[0] <= 1e-6
        if form == "end_corrected":
            assert np.abs(found.omega[1:] / OMEGA - 1).max() <= 1e-10
            assert (1 - likeness(found, shapes)).max() <= 1e-10
            assert found.warnings == ()
    drifting = pseudo_rayleigh(record, "displacement-velocity", "as_printed")
    assert any("mode 1 turns less than half a period" in note for note in drifting.warnings)


def test_two_records_separate_a_repeated_frequency():
    omega = np.array([2.0, 3.1, 3.1, 7.0])
    shapes = random_shapes(4)
    first = record_of(omega, shapes, 9.0, 0.01, velocity=np.array([1.0, 1.0, 0.5, 1.0]))
    second = record_of(omega, shapes, 6.0, 0.01, velocity=np.array([-1.0, 0.3, -2.0, 0.4]))
    one = pseudo_rayleigh(first, "displacement", "second_difference")
    assert one.n_modes == 3
    assert any("A repeated frequency excited once" in note for note in one.warnings)
    both = pseudo_rayleigh([first, second], "displacement", "second_difference")
    assert np.abs(both.omega / omega - 1).max() <= 1e-10
    assert subspace_angles(both.mode_shapes[:, 1:3], shapes[:, 1:3]).max() <= 1e-9
    ended = pseudo_rayleigh([first, second])
    assert np.abs(ended.omega / omega - 1).max() <= 1e-10


def test_a_repeated_value_split_by_rounding_gets_real_shapes():
    """A block with eigenvalues 9 +- 1e-9 i: one plane, and two real vectors that span it."""
    plane = np.array([[9.0, 1e-9], [-1e-9, 9.0]])
    values, x = _real_where_close(*np.linalg.eig(plane))
    assert np.isrealobj(values)
    assert np.isrealobj(x)
    assert values == pytest.approx([9.0, 9.0])
    assert abs(np.linalg.det(x)) > 0.1
    apart = np.array([[9.0, 1e-2], [-1e-2, 9.0]])
    assert np.iscomplexobj(_real_where_close(*np.linalg.eig(apart))[0])


def test_records_count_by_their_duration():
    whole = record_of(OMEGA, random_shapes(4), 8.0, 0.01)
    parts = [whole.values[:301], whole.values[300:]]
    split = [TimeRecord(100.0, values, whole.channels, whole.quantities) for values in parts]
    one, two = (stationary_values(r, "displacement-velocity", "as_printed") for r in (whole, split))
    assert two.eigenvalues == pytest.approx(one.eigenvalues, rel=1e-12)


def test_damping_biases_frequencies_in_second_order():
    record = record_of(OMEGA, random_shapes(4), 60.0, 0.01, velocity=np.ones(4), damping_ratio=np.full(4, 0.005))
    found = pseudo_rayleigh(record, "displacement-velocity", "end_corrected")
    assert np.abs(found.omega / OMEGA - 1).max() <= 1e-3


# ---- other structures


def membrane_with_hole(n=6):
    """Square of n by n cells without the middle ones, held at the outer rim."""
    nodes = {(n + 1) * j + i + 1: (i / n, j / n) for j in range(n + 1) for i in range(n + 1)}
    hole = {(i, j) for i in (n // 2 - 1, n // 2) for j in (n // 2 - 1, n // 2)}
    triangles = []
    for j in range(n):
        for i in range(n):
            if (i, j) not in hole:
                a = (n + 1) * j + i + 1
                triangles += [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
    used = np.unique(triangles)
    rim = [f"{k}Z" for k in used if {0.0, 1.0} & set(nodes[int(k)])]
    return Structure({int(k): nodes[int(k)] for k in used}, [Membrane("skin", triangles, 0.3, 40.0)], rim)


def portal():
    """A 3-D frame of four columns and four beams, clamped, with masses at the corners."""
    nodes = {i + 1 + 4 * level: (x, y, 3.0 * level) for level in (0, 1) for i, (x, y) in enumerate(CORNERS)}
    given = {"bending_stiffness_y": 2e5, "bending_stiffness_z": 3e5, "axial_stiffness": 1e8, "torsional_stiffness": 8e4}
    columns = SpaceBeam("columns", [[i, i + 4] for i in range(1, 5)], 20.0, **given, polar_inertia=0.1)
    beams = SpaceBeam("beams", [[5, 6], [6, 7], [7, 8], [8, 5]], 15.0, **given, polar_inertia=0.1)
    lumps = PointMass("lumps", [5, 6, 7], [300.0, 200.0, 100.0])
    fixed = [f"{i}{d}" for i in range(1, 5) for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    return Structure(nodes, [columns, beams, lumps], fixed)


CORNERS = ((0.0, 0.0), (4.0, 0.0), (4.0, 5.0), (0.0, 5.0))


def excited(structure, n_modes, sensors, n_periods=15, at=0):
    """Record of the lowest modes at `sensors` after an impulse at one of them, and the modes."""
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=n_modes)
    omega = 2 * np.pi * found.frequency
    shapes = structure.selection(sensors).T @ found.mode_shapes
    step = 0.07 / omega[-1]
    record = record_of(omega, shapes, n_periods * 2 * np.pi / omega[0], step, sensors, velocity=shapes[at])
    return record, omega, shapes


@pytest.mark.parametrize("form", EXACT)
def test_membrane_with_a_hole(form):
    structure = membrane_with_hole()
    assert structure.n_dofs == 49 - 24 - 1
    record, omega, shapes = excited(structure, 6, structure.dofs[::2], at=1)  # off the lines of symmetry
    found = pseudo_rayleigh(record, EXACT[form], form)
    assert found.n_modes == 6
    assert np.abs(found.omega / omega - 1).max() <= 1e-9
    assert (1 - likeness(found, shapes)).max() <= 1e-9


def test_frame_in_space_with_translations_and_rotations():
    structure = portal()
    sensors = [d for d in structure.dofs if d.node in (5, 6, 7)]
    record, omega, shapes = excited(structure, 5, sensors, at=0)
    for form, pair in EXACT.items():
        found = pseudo_rayleigh(record, pair, form)
        assert found.n_modes == 5
        assert np.abs(found.omega / omega - 1).max() <= 1e-9
        assert (1 - likeness(found, shapes)).max() <= 1e-9


# ---- warnings


def notes_of(record, pair="displacement-velocity", form="as_printed", **given):
    return " | ".join(pseudo_rayleigh(record, pair, form, **given).warnings)


def test_clean_record_has_no_warnings():
    assert notes_of(record_of(OMEGA, random_shapes(4))) == ""


@pytest.mark.parametrize("form", ["as_printed", "end_corrected"])
def test_close_modes_are_warned_of_until_the_record_is_long_enough(form):
    """The true gap counts: the printed form gives a gap of order 1 / T, which would never warn."""
    omega = np.array([2.0, 2.01, 7.0])
    notes = notes_of(record_of(omega, random_shapes(3, 3), 200.0, 0.05), form=form)
    assert "T x gap / pi = 0.64, below 1" in notes
    assert "at least 314 s" in notes
    assert "T x gap" not in notes_of(record_of(omega, random_shapes(3, 3), 330.0, 0.05), form=form)
    equal = np.array([2.0, 2.0, 7.0])
    both = [record_of(equal, random_shapes(3, 3), velocity=v) for v in (np.ones(3), np.array([1.0, -1.0, 1.0]))]
    assert "after other excitations" in notes_of(both, form="end_corrected")


def test_more_modes_than_sensors_are_warned_of():
    assert "more modes than sensors" in notes_of(record_of(OMEGA, random_shapes(3)))
    assert "more modes than sensors" in notes_of(
        record_of(OMEGA, random_shapes(3)), "acceleration", "second_difference"
    )


def test_reduction_by_choice_is_told():
    record = record_of(OMEGA, random_shapes(6))
    assert "6 channels reduced to 2" in notes_of(record, n_modes=2)
    assert pseudo_rayleigh(record, n_modes=2).n_modes == 2


def test_values_that_are_no_vibration_are_left_out_and_told():
    """-1 is negative; 5 lies beyond the Nyquist limit 4 / step^2 = 4; 0 and -1e-15 are rigid bodies."""
    omega, kept, notes = _omega(np.array([-1.0, -1e-15, 0.0, 1.0, 5.0]), step=1.0)
    assert kept.tolist() == [False, True, True, True, False]
    assert omega[kept] == pytest.approx([0.0, 0.0, np.pi / 3])
    assert "2 of 5 stationary values belong to no vibration" in notes[0]
    omega, kept, notes = _omega(np.array([3 + 4j, 3 - 4j]), step=0.0)
    assert kept.all()
    assert omega == pytest.approx(np.sqrt([5.0, 5.0]))
    assert "2 stationary values are complex" in notes[0]
    assert _omega(np.array([1.0, 4.0]), step=0.0)[2] == ()


def test_complex_and_negative_values_are_told():
    rng = np.random.default_rng(8)
    clean = record_of(OMEGA, random_shapes(4), 5.0)
    noisy = clean.values + 0.5 * rng.standard_normal(clean.values.shape)
    record = TimeRecord(clean.sampling_rate, noisy, clean.channels, clean.quantities)
    found = pseudo_rayleigh(record, "displacement-acceleration", "exact")
    assert found.n_modes <= 4
    assert len(found.warnings) >= 1
    assert np.isfinite(found.frequency).all()


# ---- bad input


GOOD = record_of(OMEGA, random_shapes(4))


def only(quantity, channels=4):
    keep = [i for i, q in enumerate(GOOD.quantities) if q == quantity][:channels]
    return TimeRecord(50.0, GOOD.values[:, keep], [GOOD.channels[i] for i in keep], [quantity] * len(keep))


def drifting():
    return record_of(np.zeros(1), np.ones((2, 1)), 5.0, 0.1, displacement=np.ones(1), velocity=np.ones(1))


def shorter(n):
    return TimeRecord(50.0, GOOD.values[:n], GOOD.channels, GOOD.quantities)


def with_rate(rate):
    return TimeRecord(rate, GOOD.values, GOOD.channels, GOOD.quantities)


def without_one_velocity():
    keep = [i for i in range(12) if i != 5]
    return TimeRecord(50.0, GOOD.values[:, keep], [GOOD.channels[i] for i in keep], [GOOD.quantities[i] for i in keep])


BAD = {
    "nothing": (lambda: pseudo_rayleigh([]), "at least one TimeRecord"),
    "not a record": (lambda: pseudo_rayleigh([np.ones((4, 4))]), "must be TimeRecords .* got ndarray"),
    "no velocity": (lambda: pseudo_rayleigh(only("displacement")), "no velocity channel; it holds displacement"),
    "rigid body": (lambda: pseudo_rayleigh(drifting()), "no oscillation.*rigid-body.*excite the structure"),
    "rigid body at speed": (
        lambda: pseudo_rayleigh(drifting(), "velocity", "second_difference"),
        "no oscillation",
    ),
    "at rest": (lambda: pseudo_rayleigh(TimeRecord(50.0, 0 * GOOD.values, GOOD.channels, GOOD.quantities)), "no motion"),
    "too few samples": (lambda: pseudo_rayleigh(shorter(9)), "at least 10 samples for 4 channels .* got 9"),
    "too few channels": (lambda: pseudo_rayleigh(GOOD, n_modes=5), "`n_modes` must lie from 1 to 4.*add sensors"),
    "unequal steps": (
        lambda: pseudo_rayleigh([GOOD, with_rate(60.0)], "displacement", "second_difference"),
        "one sampling step",
    ),
    "unequal channels": (lambda: pseudo_rayleigh(without_one_velocity()), "same degrees of freedom.*2Z"),
    "other channels": (lambda: pseudo_rayleigh([only("displacement"), only("displacement", 3)], "displacement",
                                               "second_difference"), "record 2 must be at the same.*4Z"),
    "unknown form": (lambda: pseudo_rayleigh(GOOD, form="best"), "`form` must be one of as_printed"),
    "unknown pair": (lambda: pseudo_rayleigh(GOOD, "jerk"), "`pair` must be one of"),
    "wrong pair": (lambda: pseudo_rayleigh(GOOD, form="exact"), "needs `pair` 'displacement-acceleration'"),
    "unknown rule": (lambda: pseudo_rayleigh(GOOD, rule="simpson"), "`rule` must be trapezoid"),
    "rule of differences": (
        lambda: pseudo_rayleigh(GOOD, "displacement", "second_difference", "left"),
        "`rule` must be 'interior'",
    ),
    "mass of wrong size": (lambda: pseudo_rayleigh(GOOD, mass=np.ones(3)), "`mass` must have shape"),
    "mass of nothing": (lambda: pseudo_rayleigh(GOOD, mass=np.array([1.0, 1.0, 0.0, 1.0])), "`mass` must be positive"),
    "tolerance": (lambda: pseudo_rayleigh(GOOD, tolerance=0.0), "`tolerance` must lie"),
    "modes out of order": (
        lambda: ModalRecord(np.array([2.0, 1.0]), np.full(2, np.nan), np.eye(2), ("1Z", "2Z")),
        "increase from mode to mode",
    ),
    "shapes of wrong size": (
        lambda: ModalRecord(np.array([1.0]), np.array([np.nan]), np.eye(2), ("1Z", "2Z")),
        "`mode_shapes` must have shape",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_words(case):
    make, fragment = BAD[case]
    with pytest.raises(InputError, match=fragment):
        make()
