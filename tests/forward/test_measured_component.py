"""Structures with a component that only its FRFs are known of, against one dense model of structure and component."""

import re
from dataclasses import replace

import numpy as np
import pytest

from measured_cases import BENDING, FREQUENCY, MOUNT, asked, beam_on_machine, dense_frf, machine_receptance
from structid import (
    Base,
    Component,
    Dashpot,
    FrfProblem,
    Friction,
    IdentifyOptions,
    InputError,
    MeasuredComponent,
    PointMass,
    RigidLink,
    RotaryInertia,
    Spring,
    Structure,
    Unknown,
    identify,
    parameters,
    simulated_record,
)
from structid.diagnose.receptances import receptances_at
from structid.forward.frf.response import response
from structid.prediction.changes import Scale
from structid.prediction.identified_model import identified_model
from structid.prediction.predict import predict_changes
from structid.prediction.quantities import Frf
from structid.unknowns.tolerances import EXACT

UNKNOWNS = [Unknown("stiffness", "mount", each=True), Unknown("bending_stiffness", "beam")]


def test_frfs_of_a_changed_structure_without_mass_are_predicted():
    """A machine on springs: all mass is in its measured FRFs, and half a spring more adds to the dynamic stiffness."""
    component = MeasuredComponent("machine", ["11Y", "12Y"], FREQUENCY, machine_receptance())
    springs = [Spring("k", ["11Y"], stiffness=[1e5]), Spring("other", ["12Y"], stiffness=[2e5])]
    structure = Structure({11: [0.0, 0.0], 12: [1.0, 0.0]}, springs, active=["Y"], measured=[component])
    unknown = parameters(structure, [Unknown("stiffness", "k")])
    model = identified_model(structure, unknown, unknown.start, np.array([[1e6]]))
    [change] = predict_changes(
        model, [Frf(["11Y"], ["11Y"], FREQUENCY[1:-1], "receptance")], [Scale("stiffness[k]", 1.5)], n_draws=50
    )
    before, after = (1 / prediction.values[:, 0, 0] for prediction in (change.before, change.after))
    assert np.abs(after - before - 5e4).max() < 1.0


def predicted(structure: Structure, record):
    unknown = parameters(structure, UNKNOWNS)
    return response(structure, unknown, record), unknown.start


def near(found, expected, tolerance=1e-10):
    assert np.abs(found - expected).max() < tolerance * np.abs(expected).max()


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_responses_are_those_of_one_dense_model(kind):
    record = asked(kind=kind)
    model, start = predicted(beam_on_machine(), record)
    receptance = dense_frf(beam_on_machine([]), record)
    near(model.values_at(start), receptance * model.kind_factor[:, None, None])
    near(model.derivatives_at(start)[0], model.values_at(start), 1e-12)


@pytest.mark.parametrize("pieces", [1, 4, 9])
def test_small_medium_and_large_models_agree(pieces):
    """4, 34 and 74 degrees of freedom, of few lines each."""
    record = asked(frequency=FREQUENCY[::10])
    model, start = predicted(beam_on_machine(subdivide=pieces), record)
    assert model.is_large == (pieces == 9)
    near(model.values_at(start), dense_frf(beam_on_machine([], subdivide=pieces), record), 1e-9)


@pytest.mark.parametrize("pieces", [1, 9])
def test_jacobian_is_that_of_differences(pieces):
    record = asked(frequency=FREQUENCY[::5])
    model, start = predicted(beam_on_machine(subdivide=pieces), record)
    _, slope = model.derivatives_at(start)
    for k, value in enumerate(start):
        step = np.zeros(len(start))
        step[k] = 1e-4 * value
        difference = (model.values_at(start + step) - model.values_at(start - step)) / (2 * step[k])
        near(slope[..., k], difference, 1e-5)


def test_interface_on_the_model_itself_and_through_ties():
    """A rigid link whose dependents are the interface."""
    nodes = {0: [0.0, 0.0], 1: [1.0, 0.0], 2: [0.7, 0.2], 3: [1.3, 0.2]}
    bare = beam_on_machine([])
    made = {"elements": [bare.elements[0]], "ties": [RigidLink("plate", 4, [11, 12])]}
    nodes = {**bare.nodes}
    component = beam_on_machine().measured
    joined, alone = (
        Structure(nodes, **made, fixed=["0Y", "0RZ"], active=["Y", "RZ"], measured=parts) for parts in (component, ())
    )
    record = asked(outputs=("1Y", "11Y", "4RZ"))
    model = response(joined, parameters(joined, UNKNOWNS[1:]), record)
    near(model.values_at(np.array([BENDING])), dense_frf(alone, record))


def test_supports_that_drive_and_a_component_at_once():
    """Motion per motion of a support, from the dense model with that support free: x = -Z_ff^-1 Z_fs."""
    base = Base("table", ["0Y"])
    record = asked(outputs=("1Y", "11Y"), inputs=("0Y",), kind="transmissibility")
    structure = beam_on_machine(bases=[base])
    model, start = predicted(structure, record)
    released = beam_on_machine([], bases=[base]).release_supports((base,))
    every = asked(outputs=("1Y", "11Y", "0Y"), inputs=("0Y",))
    receptance = dense_frf(released, every)
    near(model.values_at(start), receptance[:, :2] / receptance[:, 2:])
    _, slope = model.derivatives_at(start)
    step = np.array([0, 0, 1e-4 * BENDING])
    difference = (model.values_at(start + step) - model.values_at(start - step)) / (2 * step[2])
    near(slope[..., 2], difference, 1e-5)


def test_a_reduced_part_keeps_the_interface_of_a_component():
    bare = beam_on_machine([], subdivide=6)
    own = [MeasuredComponent("machine", ["2Y", "4Y"], FREQUENCY, machine_receptance())]
    elements = [bare.elements[0]]
    made = {"fixed": ["0Y", "0RZ"], "active": ["Y", "RZ"], "measured": own, "subdivide": 6}
    whole, reduced = (
        Structure(bare.nodes, elements, components=parts, **made)
        for parts in ((), [Component("girder", "beam", 2000.0)])
    )
    assert reduced.reductions[0].n_interface == 2
    assert reduced.n_dofs < whole.n_dofs
    record = asked(outputs=("1Y", "4Y"), inputs=("4Y",))
    one = response(whole, parameters(whole, UNKNOWNS[1:]), record)
    two = response(reduced, parameters(reduced, [Unknown("stiffness", "girder")]), record)
    near(two.values_at(np.ones(1)), one.values_at(np.array([BENDING])), 1e-4)


def test_products_without_a_jacobian_are_those_with_it():
    structure = beam_on_machine()
    unknown = parameters(structure, UNKNOWNS)
    record = simulated_record(structure, unknown, asked(), 0.01, np.random.default_rng(0))
    problem = FrfProblem(structure, unknown, record)
    jacobian = problem.linearize(problem.theta_start).jacobian
    operator = problem.linearize_operator(problem.theta_start, stored_bytes=0)
    v, u = np.arange(1.0, 4.0), np.linspace(-1, 1, problem.n_data)
    n_data = problem.n_data
    np.testing.assert_allclose(
        operator.forward(v), jacobian[:n_data] @ v, rtol=1e-8, atol=1e-8 * np.abs(jacobian).max()
    )
    np.testing.assert_allclose(operator.adjoint(u), jacobian[:n_data].T @ u, rtol=1e-8)


def test_a_mass_and_a_soil_by_their_frfs_are_those_of_elements():
    """A beam that nothing else holds, on impedances of a spring and a dashpot each, with a rigid body at its end."""
    s = 2j * np.pi * FREQUENCY
    soil, body = np.zeros((2, len(s), 2, 2), dtype=complex)
    soil[:, 0, 0], soil[:, 1, 1] = 1 / (2e4 + 30 * s), 1 / (5e3 + 4 * s)
    body[:, 0, 0], body[:, 1, 1] = 1 / (2.5 * s**2), 1 / (0.02 * s**2)
    known = [
        MeasuredComponent("soil", ["0Y", "0RZ"], FREQUENCY, soil),
        MeasuredComponent("body", ["4Y", "4RZ"], FREQUENCY, body),
    ]
    made = [
        Spring("soil", ["0Y", "0RZ"], stiffness=[2e4, 5e3]),
        Dashpot("loss", ["0Y", "0RZ"], viscous_damping=[30.0, 4.0]),
        PointMass("body", [4], mass=2.5),
        RotaryInertia("turning", [4], rotary_inertia=0.02, direction="RZ"),
    ]
    beam = beam_on_machine([]).elements[0]
    nodes = {k: [0.3 * k, 0.0] for k in range(5)}
    measured, modelled = (
        Structure(nodes, [beam, *others], active=["Y", "RZ"], measured=parts)
        for others, parts in (([], known), (made, []))
    )
    record = asked(outputs=("0Y", "0RZ", "2Y"), inputs=("4Y", "0RZ"))
    one, two = (response(it, parameters(it, UNKNOWNS[1:]), record) for it in (measured, modelled))
    near(one.values_at(np.array([BENDING])), two.values_at(np.array([BENDING])))


def test_two_components_are_one_with_no_coupling():
    y = machine_receptance()
    apart = np.zeros_like(y)
    apart[:, 0, 0], apart[:, 1, 1] = y[:, 0, 0], y[:, 1, 1]
    both = [MeasuredComponent("both", ["11Y", "12Y"], FREQUENCY, apart)]
    each = [
        MeasuredComponent("left", "11Y", FREQUENCY, y[:, :1, :1]),
        MeasuredComponent("right", "12Y", FREQUENCY, y[:, 1:, 1:]),
    ]
    one, two = (predicted(beam_on_machine(parts), asked()) for parts in (both, each))
    near(two[0].values_at(two[1]), one[0].values_at(one[1]), 1e-12)


def test_senses_of_the_interface_turn_the_component():
    y = machine_receptance() * np.array([[1, -1], [-1, 1]])
    turned = beam_on_machine([MeasuredComponent("machine", ["11Y", "12Y-"], FREQUENCY, y)])
    (one, start), (two, _) = predicted(beam_on_machine(), asked()), predicted(turned, asked())
    near(two.values_at(start), one.values_at(start), 1e-12)


def test_friction_slides_in_a_structure_with_a_component():
    """Balance of a contact, from a model whose friction is the damping that it comes to."""
    structure = beam_on_machine()
    rubbed = replace(structure, elements=[*structure.elements, Friction("rub", "3Y", friction_force=0.3)])
    unknown = parameters(rubbed, [*UNKNOWNS, Unknown("friction_force", "rub")])
    model = response(rubbed, unknown, asked())
    values, slope = model.derivatives_at(unknown.start)
    flat = asked(outputs=("3Y", "1Y"), inputs=("3Y",))
    free, start = predicted(structure, flat)
    receptance = free.values_at(start)[:, :, 0]
    slip = -values[:, 1, 0]  # the sensor at 3Y looks the other way
    pull = 1j * 0.3 * slip / np.abs(slip)
    near(receptance[:, 0] * (1 - pull), slip, 1e-6)
    near(receptance[:, 1] * (1 - pull), values[:, 0, 0], 1e-6)
    step = 1e-5 * np.diag(unknown.start)
    for k, change in enumerate(step):
        difference = (model.values_at(unknown.start + change) - model.values_at(unknown.start - change)) / (
            2 * change[k]
        )
        near(slope[..., k], difference, 1e-4)


def test_candidate_changes_see_the_component():
    structure = beam_on_machine()
    unknown = parameters(structure, UNKNOWNS)
    record = simulated_record(structure, unknown, asked(), 0.01, np.random.default_rng(0))
    problem = FrfProblem(structure, unknown, record)
    fields = receptances_at(problem, problem.theta_start)
    seen = structure.selection(record.outputs).toarray().T @ fields.under_loads
    near(seen, fields.frf)


def test_lines_between_are_interpolated_where_its_own_are_dense():
    fine = np.linspace(1.5, 121.0, 600)
    between = beam_on_machine([MeasuredComponent("machine", ["11Y", "12Y"], fine, machine_receptance(fine))])
    model, start = predicted(between, asked())
    near(model.values_at(start), dense_frf(beam_on_machine([]), asked()), 1e-3)
    [told] = between.measured[0].line_warnings(FREQUENCY)
    assert re.search(r"1\d\d of 140 lines lie between its own and are interpolated", told)


def test_a_changed_copy_is_as_if_it_were_made_so():
    y = machine_receptance()
    y[:, 0, 1] *= 1.5
    own = MeasuredComponent("m", ["11Y", "12Y"], FREQUENCY, y)
    other = replace(own, name="n")
    np.testing.assert_array_equal(other.receptance_at(FREQUENCY), own.receptance_at(FREQUENCY))
    assert [words.replace("'n'", "'m'") for words in other.warnings] == list(own.warnings)
    mean = (y[:, 0, 1] + y[:, 1, 0]) / 2
    np.testing.assert_allclose(own.receptance_at(FREQUENCY)[:, 0, 1], mean)
    np.testing.assert_allclose(own.receptance_at(FREQUENCY)[:, 1, 0], mean)


def test_what_lines_read_of_it_is_worked_out_once():
    [own] = beam_on_machine().measured
    found = own.receptance_at(FREQUENCY[3:9])
    assert own.receptance_at(FREQUENCY[3:9].copy()) is found
    np.testing.assert_allclose(found, own.receptance[3:9])
    for first in range(40):
        np.testing.assert_allclose(own.receptance_at(FREQUENCY[first:]), own.receptance[first:])
    with pytest.raises(ValueError, match="read-only"):
        found[0] = 0.0


def refused(component: MeasuredComponent, record=None) -> str:
    with pytest.raises(InputError) as caught:
        predicted(beam_on_machine([component]), record or asked())
    return str(caught.value)


def test_what_is_no_component_is_refused():
    y, ends = machine_receptance(), ["11Y", "12Y"]
    assert "must have shape (140, 2, 2)" in _error(lambda: MeasuredComponent("m", ends, FREQUENCY, y[:, :, :1]))
    assert "must increase" in _error(lambda: MeasuredComponent("m", ends, FREQUENCY[::-1], y))
    assert "each once" in _error(lambda: MeasuredComponent("m", ["11Y", "11Y-"], FREQUENCY, y))
    short = MeasuredComponent("m", ends, FREQUENCY[:100], y[:100])
    assert "was measured from 2 to 86.0432 Hz, and a line lies at 86.8921 Hz" in refused(short)
    coarse = np.linspace(2.0, 120.0, 40)
    words = refused(MeasuredComponent("m", ends, coarse, machine_receptance(coarse)))
    assert "has no line at 2.84892 Hz, and its lines are too far apart to read between them" in words
    same = np.repeat(y[:, :1, :1], 2, axis=1).repeat(2, axis=2)
    words = refused(MeasuredComponent("m", ends, FREQUENCY, same))
    assert re.search(r"the condition number of its FRFs at [\d.]+ Hz is (inf|\de\+\d+)", words)
    dead = y * np.array([1.0, 0.0]) * np.array([[1.0], [0.0]])
    assert "12Y+ does not move under its own force at 2 Hz" in refused(MeasuredComponent("m", ends, FREQUENCY, dead))
    assert "node 11 moves in 11Y+; join the component to" in _error(
        lambda: beam_on_machine([MeasuredComponent("m", "11X", FREQUENCY, y[:, :1, :1])])
    )
    assert "held at zero" in _error(lambda: beam_on_machine([MeasuredComponent("m", "0Y", FREQUENCY, y[:, :1, :1])]))
    twice = [MeasuredComponent("mount", ends, FREQUENCY, y)]
    assert "two parts of the structure are called 'mount'" in _error(lambda: beam_on_machine(twice))
    decaying = replace(asked(), decay=np.full(len(FREQUENCY), 3.0))
    assert "correct the record for its window" in refused(beam_on_machine().measured[0], decaying)


def _error(made) -> str:
    with pytest.raises(InputError) as caught:
        made()
    return str(caught.value)


def test_what_is_odd_in_its_frfs_is_said():
    y = machine_receptance()
    turned = y.copy()
    turned[:, 0, 1] *= 1.5
    words = MeasuredComponent("m", ["11Y", "12Y"], FREQUENCY, turned).warnings
    assert any("from the reciprocal ones" in one for one in words)
    words = MeasuredComponent("m", ["11Y", "12Y"], FREQUENCY, -y).warnings
    assert sum("is negative at 100 % of all its lines; check" in one for one in words) == 2
    [own] = beam_on_machine().measured
    [words] = own.warnings
    assert "masses told are without it, and errors of its FRFs are not in the intervals" in words
    assert own.line_warnings(FREQUENCY) == ()


def identified(seed: int, component_noise: float = 0.0, is_stated: bool = False, own=FREQUENCY):
    """Errors in standard deviations of three stiffnesses, 30 % off at the start, and the estimate; fixed values are exact."""
    rng = np.random.default_rng(seed)
    record = asked(outputs=("1Y", "3Y", "4Y"), kind="accelerance")
    true = beam_on_machine()
    record = simulated_record(true, parameters(true, UNKNOWNS), record, 0.01, rng)
    y = machine_receptance(own)
    noise = rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)
    known = MeasuredComponent(
        "machine",
        ["11Y", "12Y"],
        own,
        y * (1 + component_noise * noise / np.sqrt(2)),
        variance=(component_noise * np.abs(y)) ** 2 if is_stated else None,
    )
    structure = beam_on_machine([known], mount=MOUNT * [1.3, 0.7], bending=0.7 * BENDING)
    found = identify(structure, parameters(structure, UNKNOWNS), record, IdentifyOptions(tolerances=EXACT)).estimate
    return (found.values - [*MOUNT, BENDING]) / found.std, found


def test_stiffnesses_come_back_with_honest_deviations():
    off = np.array([identified(seed)[0] for seed in range(20)])
    assert 0.8 < np.sqrt(np.mean(off**2)) < 1.2


@pytest.mark.parametrize("own", [FREQUENCY, np.linspace(1.0, 125.0, 400)])
@pytest.mark.parametrize("form", ["output", "log"])
def test_errors_of_a_component_change_the_data_rows_as_differences_do(form, own):
    """At its own lines and between them, with a sense of the interface, a load that is a sensor, and an error of a channel."""
    rng = np.random.default_rng(0)
    y, size = machine_receptance(own), 0.02 * rng.random((len(own), 2, 2))
    variance = (size * np.abs(y)) ** 2
    record = asked(outputs=("1Y", "3Y-", "11Y"), inputs=("3Y", "1Y"), kind="mobility", frequency=FREQUENCY[::7])
    record = replace(record, variance=np.full(record.values.shape, 1e-10))

    def problem(receptance, variance=None):
        one = MeasuredComponent("machine", ["11Y", "12Y-"], own, receptance, variance=variance)
        structure = beam_on_machine([one])
        return FrfProblem(structure, parameters(structure, UNKNOWNS), record, form)

    at = problem(y, variance)
    theta = at.theta_start
    found = at.noise_law(theta).factor
    assert np.array_equal(found[: at.n_data], np.eye(at.n_data))
    jacobian = at.linearize(theta).jacobian[: at.n_data]
    expected = (found @ jacobian).T @ (found @ jacobian)
    near(at.noise_law(theta).score_covariance(jacobian), expected)
    found = found[at.n_data :].reshape(3, 2, len(own), -1)  # entries 00, 01, 11; real and imaginary parts; own lines
    pairs, line = [(0, 0), (0, 1), (1, 1)], int(np.abs(own - FREQUENCY[42]).argmin())
    for k, (i, j) in enumerate(pairs):
        for part, turn in enumerate((1.0, 1j)):
            step = np.zeros_like(y)
            mean = variance[line, i, j] if i == j else (variance[line, 0, 1] + variance[line, 1, 0]) / 4
            step[line, i, j] = step[line, j, i] = 1e-3 * turn * np.sqrt(mean / 2)
            ends = [problem(y + sign * step).residual(theta)[: at.n_data] for sign in (1, -1)]
            near(found[k, part, line], (ends[0] - ends[1]) / 2e-3, 1e-5)
    assert at.has_component_errors
    assert not problem(y).has_component_errors
    assert problem(y).noise_law(theta).factor is None


@pytest.mark.parametrize("own", [FREQUENCY, pytest.param(np.linspace(1.0, 125.0, 400), marks=pytest.mark.long)])
def test_stated_errors_of_a_component_are_in_the_intervals(own):
    """1 % in the record, 2 % in the machine's FRFs; left out, deviations are far too small."""
    off = []
    for seed in range(16):
        errors, found = identified(seed, 0.02, True, own)
        off.append(errors)
        assert found.covariance_basis == "noise"
    assert 0.75 < np.sqrt(np.mean(np.square(off))) < 1.25


def test_variances_of_a_component_that_are_none_are_refused():
    y = machine_receptance()
    for variance, words in ((-np.ones(y.shape), "must not be negative"), (np.ones((3, 2, 2)), "variance")):
        with pytest.raises(InputError, match=words):
            MeasuredComponent("machine", ["11Y", "12Y"], FREQUENCY, y, variance=variance)
    stated = MeasuredComponent("machine", ["11Y", "12Y"], FREQUENCY, y, variance=np.abs(y) ** 2)
    assert stated.warnings == ("measured component 'machine': masses told are without it",)
