"""Large models, swept line by line, against dense matrices written out here, and against differences."""

import gc
import pickle
import sys
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import structid as sid
from structid.core.errors import InputError
from structid.dynamics.factorization import installed_factorizers
from structid.forward.frf.response import ResponseCache, response
from structid.forward.frf.solvers import sweep_error
from structid.forward.sensitivity import element_products
from structid.identification.options import IdentifyOptions
from structid.unknowns.priors import priors_of

sys.path.insert(0, str(Path(__file__).parents[1]))
from mesh_cases import empty_record, solid

FREQUENCY = np.linspace(40.0, 2000.0, 6)
SHAPES = {"plate": ((8, 5), (2.0, 1.0)), "block": ((4, 3, 2), (1.5, 1.0, 1.0))}
LAWS = ("mass", "damping", "stiffness", "structural_damping")


def model(shape="plate", n_sensors=5, n_loads=2, each=True, loss=0.02, **options):
    """Unknown stiffness and mass of elements or groups, and a loss factor; 96 or 144 degrees of freedom."""
    structure = solid(*SHAPES[shape], groups=3, loss=loss)
    names = [element.name for element in structure.elements]
    unknowns = [sid.Unknown(kind, name, each=each) for name in names for kind in ("young", "density")]
    unknowns += [sid.Unknown("loss_factor", "part1", each=each)] if loss else []
    made = sid.parameters(structure, unknowns)
    record = empty_record(structure, FREQUENCY, n_sensors, n_loads)
    turned = (replace(record.outputs[0], sign=-1), *record.outputs[1:])
    record = replace(record, outputs=turned, inputs=(*record.inputs[:-1], replace(record.inputs[-1], sign=-1)))
    return structure, made, record, response(structure, made, record, **options)


def dense_values(structure, made, record, physical):
    """S' Z^-1 F by dense matrices."""
    matrices = {law: structure.matrix(law, made.values(physical)).toarray() for law in LAWS}
    loads, sensors = (structure.selection(d).toarray() for d in (record.inputs, record.outputs))
    found = []
    for s in 2j * np.pi * record.frequency:
        z = (
            s**2 * matrices["mass"]
            + s * matrices["damping"]
            + matrices["stiffness"]
            + 1j * matrices["structural_damping"]
        )
        found.append(sensors.T @ np.linalg.solve(z, loads.astype(complex)))
    return np.array(found)


@pytest.mark.parametrize("name", installed_factorizers())
@pytest.mark.parametrize("shape", list(SHAPES))
def test_values_equal_dense_matrices(shape, name):
    structure, made, record, at = model(shape, cache=ResponseCache(name))
    assert at.is_large
    exact = dense_values(structure, made, record, made.start)
    assert at.values_at(made.start) == pytest.approx(exact, rel=1e-9, abs=1e-10 * np.abs(exact).max())


@pytest.mark.parametrize(
    "each, n_sensors, loss", [(True, 5, 0.02), (False, 5, 0.02), (False, 40, 0.02), (True, 5, 0.0)]
)
def test_jacobian_equals_differences_of_dense_matrices(each, n_sensors, loss):
    """By adjoint fields, by direct sensitivities where sensors are more (40 against 7 x 2), and undamped."""
    structure, made, record, at = model(n_sensors=n_sensors, each=each, loss=loss)
    rng = np.random.default_rng(5)
    physical = made.start * (1 + 0.1 * rng.standard_normal(made.n_params))
    values, derivative = at.derivatives_at(physical)
    assert values == pytest.approx(dense_values(structure, made, record, physical), rel=1e-8)
    for column in rng.choice(made.n_params, min(made.n_params, 9), replace=False):
        step = np.zeros(made.n_params)
        step[column] = 1e-5 * physical[column]
        change = [dense_values(structure, made, record, physical + sign * step) for sign in (2, 1, -1, -2)]
        exact = (8 * (change[1] - change[2]) - (change[0] - change[3])) / (12 * step[column])
        assert derivative[..., column] == pytest.approx(exact, rel=1e-6, abs=1e-6 * np.abs(exact).max())


def test_direct_and_adjoint_sensitivities_agree_and_accelerance_scales_both():
    structure, made, record, _ = model(each=False, n_sensors=40)
    few = record.channels(record.outputs[:5])
    for kind in ("receptance", "accelerance"):
        direct = response(structure, made, replace(record, kind=kind)).derivatives_at(made.start)
        adjoint = response(structure, made, replace(few, kind=kind)).derivatives_at(made.start)
        for a, b in zip(direct, adjoint, strict=True):
            assert a[:, :5] == pytest.approx(b, rel=1e-8, abs=1e-9 * np.abs(b).max())


def test_sensor_gram_by_lines_equals_dense():
    structure, made, record, at = model()
    sensors = structure.selection(record.outputs).toarray()
    matrices = {law: structure.matrix(law, made.values(made.start)).toarray() for law in LAWS}
    s = 2j * np.pi * record.frequency[2]
    y = np.linalg.solve(s**2 * matrices["mass"] + matrices["stiffness"] + 1j * matrices["structural_damping"], sensors)
    assert at.sensor_gram(made.start)[2] == pytest.approx(y.T @ y.conj(), rel=1e-8)


def test_friction_in_a_large_model_equals_differences():
    chain = sid.Spring("chain", [f"{i}X" for i in range(80)], [f"{i + 1}X" for i in range(80)], stiffness=1000.0)
    soft = sid.Spring("ground", "60X", stiffness=50.0, loss_factor=0.05)
    masses = sid.PointMass("m", list(range(1, 81)), 1.0, directions=("X",))
    slider = sid.Friction("slider", "40X", friction_force=0.02)
    nodes = {i: float(i) for i in range(81)}
    structure = sid.Structure(nodes, [chain, soft, masses, slider], ["0X"], active=["X"])
    made = sid.parameters(structure, [sid.Unknown("stiffness", "ground"), sid.Unknown("friction_force", "slider")])
    record = sid.FrfRecord(np.linspace(0.1, 1.0, 5), np.ones((5, 2, 1)), ("20X", "60X"), ("60X",), "receptance")
    at = response(structure, made, record)
    assert at.is_large
    derivative = at.derivatives_at(made.start)[1]
    for column in range(2):
        step = np.zeros(2)
        step[column] = 1e-5 * made.start[column]
        exact = (at.values_at(made.start + step) - at.values_at(made.start - step)) / (2 * step[column])
        assert derivative[..., column] == pytest.approx(exact, rel=1e-5, abs=1e-6 * np.abs(exact).max())


def test_reduced_sweep_of_a_model_keeps_its_promise():
    structure, made, record, _ = model()
    record = empty_record(structure, np.linspace(40.0, 2000.0, 60), 5, 2)
    full = response(structure, made, record).values_at(made.start)
    reduced = response(structure, made, record, reduced=1e-6).values_at(made.start)
    assert (np.abs(reduced - full).max((1, 2)) <= 1e-6 * np.abs(full).max((1, 2))).all()
    assert not np.array_equal(reduced, full)


def derivative_errors(found, exact):
    """Of each line, the root mean square over parameters of the relative error."""
    size = np.linalg.norm(exact, axis=(1, 2))
    return np.sqrt(((np.linalg.norm(found - exact, axis=(1, 2)) / size) ** 2).mean(axis=1))


@pytest.mark.parametrize("loss", [0.0, 0.02])
def test_reduced_derivatives_keep_their_promise(loss):
    structure, made, _, _ = model("block", loss=loss)
    record = empty_record(structure, np.linspace(40.0, 1500.0, 60), 4, 2)
    record = replace(record, kind="accelerance", inputs=(record.inputs[0], replace(record.inputs[1], sign=-1)))
    rng = np.random.default_rng(7)
    full, at = response(structure, made, record), response(structure, made, record, reduced=1e-6)
    for physical in (made.start, made.start * (1 + 0.1 * rng.standard_normal(made.n_params))):
        (values, slopes), (exact, true) = at.derivatives_at(physical), full.derivatives_at(physical)
        assert (np.abs(values - exact).max((1, 2)) <= 1e-6 * np.abs(exact).max((1, 2))).all()
        assert derivative_errors(slopes, true).max() <= 1e-5
        assert not np.array_equal(slopes, true)
    assert at.solver.last_sweep.n_factorizations < 40
    assert 0 < at.solver.last_sweep.n_basis < structure.n_dofs


def test_reduced_values_and_derivatives_share_a_sweep_and_do_not_depend_on_what_came_before():
    structure, made, _, _ = model("block")
    record = empty_record(structure, np.linspace(40.0, 1500.0, 40), 4, 1)
    at, other = (response(structure, replace(made), record, reduced=1e-6) for _ in range(2))
    values = at.values_at(made.start)
    count = at.solver.last_sweep.n_factorizations
    assert np.array_equal(at.derivatives_at(made.start)[0], other.derivatives_at(made.start)[0])
    assert at.solver.last_sweep.n_factorizations == count
    other.values_at(1.2 * made.start)
    assert np.array_equal(other.values_at(made.start), values)
    assert at.derivatives_at(made.start)[0] == pytest.approx(values, rel=1e-9, abs=1e-12 * np.abs(values).max())
    copied = pickle.loads(pickle.dumps(at.solver.last_sweep))
    assert (copied.n_factorizations, copied.n_basis, copied.readings) == (count, 0, {})


def test_reduced_fields_serve_a_search_without_a_jacobian():
    structure, made, _, _ = model("block")
    record = empty_record(structure, np.linspace(40.0, 1500.0, 40), 4, 1)
    record = replace(record, variance=np.full(record.values.shape, 1e-18))
    full, short = (sid.FrfProblem(structure, made, record, reduced=reduced) for reduced in (None, 1e-6))
    exact, found = full.linearize(full.theta_start), short.linearize_operator(short.theta_start)
    v = np.random.default_rng(3).standard_normal(made.n_params)
    assert found.product(v) == pytest.approx(exact.jacobian @ v, abs=1e-3 * np.abs(exact.jacobian @ v).max())
    assert short.model.solver.last_sweep.n_factorizations < 20


def test_error_of_a_sweep_weighs_readings_and_derivatives():
    """Fields that are off by a known part: readings by as much, derivatives by the sum of both fields' parts."""
    _, made, _, at = model(n_sensors=4, n_loads=1)
    fields = at.fields_at(made.start, at.channels.columns)[2]
    maps, factors = at.slopes.forces_at(made.start, at.fixed_coefficients)
    loads = np.unique(at.channels.inputs[0])
    for part, tolerance, worst in ((1e-3, 1e-6, 1e3), (1e-9, 1e-6, 1e-3)):
        off = fields * (1 + part)
        assert sweep_error(tolerance, at.channels.sensors, loads, (maps, factors))(2, fields, off) == pytest.approx(
            worst, rel=1e-2
        )
    others = np.setdiff1d(np.arange(fields.shape[1]), loads)
    off = fields.copy()
    off[:, others] *= 1.01  # fields of sensors alone: readings do not feel it
    error = sweep_error(1e-3, at.channels.sensors, loads, (maps, factors))(2, fields, off)
    assert 0.5 < error <= 1.0


def test_the_factorizer_goes_with_the_models():
    structure, made, record, _ = model()
    record = replace(record, variance=np.ones(record.values.shape))
    problem = pickle.loads(pickle.dumps(sid.FrfProblem(structure, made, record, cache=ResponseCache("superlu"))))
    assert problem.model.solver.pattern.factorizer == "superlu"
    with pytest.raises(InputError, match=r"write cache=ResponseCache\('superlu'\)"):
        sid.FrfProblem(structure, made, record, factorizer="superlu")


def test_lines_in_use_are_shared_where_all_is_the_same():
    structure, made, record, _ = model()
    cache = ResponseCache()

    def lines(unknown=made, record=record, cache=cache, **options):
        return response(structure, unknown, record, cache=cache, **options).solver

    at = lines()
    assert lines(record=replace(record, values=2 * record.values)) is at
    assert lines(record=replace(record, kind="mobility")) is at
    assert lines(unknown=made.kept_near_start(0.1)) is at
    for other in (lines(reduced=1e-6), lines(record=record.lines(np.arange(2)))):
        assert other is not at
        assert other.pattern is at.pattern
    for other in (lines(cache=ResponseCache("superlu")), lines(record=record.channels(record.outputs[:2]))):
        assert other.pattern is not at.pattern
    assert response(structure, made, record).solver is not at
    kept = weakref.ref(at)
    del at
    gc.collect()
    assert kept() is None


def test_problems_made_from_one_another_share_their_lines():
    problem = noisy("output")
    eased = replace(problem.with_parts([problem.parameters.kept_near_start(0.3)]), form="pole_free")
    few = problem.with_lines(np.arange(2))
    assert eased.model.solver is problem.model.solver
    assert few.model.solver.pattern is problem.model.solver.pattern
    one, two = pickle.loads(pickle.dumps((problem, few)))
    assert one.cache is two.cache is not problem.cache


def test_reduction_asked_for_in_a_study_reaches_the_model():
    structure, made, record, _ = model()
    record = replace(record, variance=np.full(record.values.shape, 1e-18))
    problem = sid.Setup(structure, made, record).prepared(IdentifyOptions(reduced=1e-5)).problem
    assert problem.model.solver.reduced == 1e-5
    assert problem.predicted_on(record, made.start) == pytest.approx(problem.predicted(made.theta_start), rel=1e-12)


def test_large_models_are_swept_by_default_and_the_true_error_is_told(monkeypatch):
    structure, made, record, _ = model("block", n_sensors=3, n_loads=1, each=False)
    lines = np.linspace(40.0, 900.0, 24)
    record = replace(record, frequency=lines, values=np.ones((24, 3, 1)), variance=np.ones((24, 3, 1)))
    monkeypatch.setattr("structid.identification.setups.frf._LARGE", 100)
    setup = sid.Setup(structure, made, record)

    def prepared(**options):
        return setup.prepared(IdentifyOptions(**options)).problem

    assert prepared().reduced == 1e-5
    assert prepared(reduced=1e-3).reduced == 1e-3
    assert prepared(reduced=0).reduced is None
    assert prepared(band=(40.0, 500.0)).reduced is None  # 13 lines
    exact = prepared(reduced=0)
    assert setup.truncation(exact, exact.theta_start) is None
    rough = prepared(reduced=0.01)
    told = setup.truncation(rough, rough.theta_start)
    one, other = (problem.predicted(problem.theta_start) for problem in (rough, exact))
    errors = np.abs(one - other).max(axis=(1, 2)) / np.abs(other).max(axis=(1, 2))
    assert told.error == pytest.approx(errors[np.abs(errors - told.error).argmin()], rel=1e-6)
    assert 0 < told.error <= errors.max() * (1 + 1e-9)
    assert told.remedy == "take a smaller `reduced`"
    monkeypatch.setattr("structid.identification.setups.frf._LARGE", 1000)
    assert prepared().reduced is None


def test_a_sweep_is_come_back_to():
    """A point that was tried before the last one costs no factorization again."""
    structure, made, record, _ = model("block", n_sensors=3, n_loads=1, each=False)
    lines = np.linspace(40.0, 900.0, 24)
    record = replace(record, frequency=lines, values=np.ones((24, 3, 1)))
    at = response(structure, made, record, reduced=1e-6)
    first = at.derivatives_at(made.start)[1]
    at.values_at(1.01 * made.start)
    count = at.solver.last_sweep.n_factorizations
    assert np.array_equal(at.derivatives_at(made.start)[1], first)
    assert at.solver.last_sweep.n_factorizations == count
    at.values_at(1.02 * made.start)
    at.values_at(1.03 * made.start)
    count = at.solver.last_sweep.n_factorizations
    assert np.array_equal(at.derivatives_at(made.start * (1 + 2e-16))[1], first)
    assert at.solver.last_sweep.n_factorizations == count
    at.derivatives_at(1.01 * made.start)
    assert at.solver.last_sweep.n_factorizations > count


def test_derivatives_by_the_basis_are_those_of_its_fields():
    """Parameters with many nodes take the forces through the basis, others line by line."""
    structure, made, record, _ = model("block", n_sensors=3, n_loads=2, each=False)
    lines = np.linspace(40.0, 900.0, 24)
    record = replace(record, frequency=lines, values=np.ones((24, 3, 2)))
    record = replace(record, inputs=(record.inputs[0], replace(record.inputs[1], sign=-1)))
    at = response(structure, made, record, reduced=1e-6)
    by_basis = at.derivatives_at(made.start)
    assert at.solver.last_sweep.derivatives
    fields = np.concatenate([x for _, x in at.solved_at(made.start)])
    x, y = at.channels.under_loads(fields), at.channels.under_sensors(fields)
    expected = at.sensitivity_at(made.start, x, y)
    assert by_basis[1] == pytest.approx(expected, rel=1e-9, abs=1e-10 * np.abs(expected).max())
    assert by_basis[0] == pytest.approx(at.channels.read(x), rel=1e-9)


def test_few_lines_are_not_reduced():
    structure, made, record, at = model(reduced=1e-3)
    full = response(structure, made, record)
    for found, exact in zip(at.derivatives_at(made.start), full.derivatives_at(made.start), strict=True):
        assert np.array_equal(found, exact)


def test_derivatives_follow_loss_factors_from_one_set_of_parameters_to_the_next():
    """What is kept of the weights of element matrices depends on loss factors, and on what they multiply."""
    _, made, record, at = model()
    is_loss = np.array(["loss" in name for name in made.names])
    at.derivatives_at(made.start)
    for which in (~is_loss, is_loss):
        moved = np.where(which, 1.3, 1.0) * made.start
        fresh = response(at.slopes.structure, replace(made), record)
        assert fresh is not at
        exact = fresh.derivatives_at(moved)[1]
        assert at.derivatives_at(moved)[1] == pytest.approx(exact, rel=1e-9, abs=1e-12 * np.abs(exact).max())


def noisy(form, shape="plate", **options):
    structure, made, record, at = model(shape)
    rng = np.random.default_rng(2)
    values = at.values_at(made.start) * (1 + 0.1 * rng.standard_normal(record.values.shape))
    record = replace(record, values=values, variance=(0.03 * np.abs(values)) ** 2)
    priors = priors_of(sid.Prior(value, 0.2) if i % 3 else None for i, value in enumerate(made.start))
    made = replace(made, priors=priors)
    return sid.FrfProblem(structure, made, record, form, **options)


@pytest.mark.parametrize("form", ["output", "log", "pole_free"])
@pytest.mark.parametrize("stored", [0.0, 1e9])
def test_products_without_a_jacobian_equal_those_with_it(form, stored):
    problem = noisy(form)
    rng = np.random.default_rng(1)
    theta = problem.theta_start + 0.1 * rng.standard_normal(len(problem.names))
    at, free = problem.linearize(theta), problem.linearize_operator(theta, stored)
    v, u = rng.standard_normal(len(theta)), rng.standard_normal(len(at.residual))
    assert free.n_data == problem.n_data
    assert free.residual == pytest.approx(at.residual, rel=1e-9)
    assert free.product(v) == pytest.approx(at.jacobian @ v, rel=1e-9, abs=1e-9 * np.abs(at.jacobian @ v).max())
    assert free.transposed(u) == pytest.approx(at.jacobian.T @ u, rel=1e-9, abs=1e-9 * np.abs(at.jacobian.T @ u).max())
    assert free.squares == pytest.approx((at.jacobian**2).sum(axis=0), rel=1e-9)
    assert ("is stored" in free.words) == bool(stored)
    assert u @ free.product(v) == pytest.approx(v @ free.transposed(u), rel=1e-11)


def test_products_on_groups_of_matrices_equal_those_with_the_jacobian():
    blocks, made, record, _ = model(each=False)
    groups = {}
    for element, name in zip(blocks.elements, ("a", "b", "c"), strict=True):
        alone = sid.Structure(blocks.nodes, [element], blocks.fixed, active=blocks.active)
        place = np.array([blocks.dofs.index(dof) for dof in alone.dofs])
        wide = {}
        for key, law in (("mass", "mass"), ("stiffness", "stiffness")):
            wide[key] = np.zeros((blocks.n_dofs, blocks.n_dofs))
            wide[key][np.ix_(place, place)] = alone.matrix(law).toarray()
        groups[name] = {**wide, "loss_factor": 0.02}
    structure = sid.from_matrices(groups, blocks.dofs)
    made = sid.parameters(structure, [sid.Unknown(k, g) for g in groups for k in ("mass", "stiffness")])
    problem = sid.FrfProblem(structure, made, replace(record, variance=np.full(record.values.shape, 1e-18)))
    at, free = problem.linearize(problem.theta_start), problem.linearize_operator(problem.theta_start, 0.0)
    rng = np.random.default_rng(4)
    v, u = rng.standard_normal(len(made.names)), rng.standard_normal(len(at.residual))
    assert free.product(v) == pytest.approx(at.jacobian @ v, rel=1e-8, abs=1e-9 * np.abs(at.jacobian @ v).max())
    assert free.transposed(u) == pytest.approx(at.jacobian.T @ u, rel=1e-8, abs=1e-9 * np.abs(at.jacobian.T @ u).max())


def test_element_products_equal_a_loop():
    structure, _, _, _ = model()
    blocks = structure.contributions[0].blocks
    rng = np.random.default_rng(0)
    y, x = (rng.standard_normal((blocks.n_dofs, 3)) + 1j * rng.standard_normal((blocks.n_dofs, 3)) for _ in range(2))
    one = np.eye(blocks.n_elements)
    exact = [np.sum(y.conj() * (blocks.assemble(row) @ x)).real for row in one]
    assert element_products(blocks, y, x) == pytest.approx(np.array(exact), rel=1e-10)


def test_products_refuse_what_they_cannot_do():
    problem = noisy("equation")
    with pytest.raises(sid.InputError, match="takes no residual of form 'equation'"):
        problem.linearize_operator(problem.theta_start)
