"""Channels beside the initial model: each fault is named, and right models that start far off are left alone."""

from dataclasses import replace

import numpy as np
import pytest

from structid import Base, Beam, FrfRecord, PointMass, Spring, Structure, Unknown, parameters
from structid.core.units import STANDARD_GRAVITY
from structid.diagnose.checks.initial_comparison import (
    ResonancePair,
    _can_judge,
    aligned,
    channel_warnings,
    in_order,
    resonance_pairs,
)
from structid.forward import FrfProblem, simulated_record

FREQUENCY = np.arange(2.0, 60.0, 0.2)
STOREYS = (1, 2, 3, 4, 5)


def shear_frame(mass=100.0, stiffness=1.5e6, loss_factor=0.03):
    """Five floors, springs from each to the one below, in kg and N/m."""
    nodes = {i: (float(i), 0.0) for i in range(6)}
    floors = PointMass("floor", list(STOREYS), mass)
    first, second = [f"{i}X" for i in STOREYS], [f"{i - 1}X" for i in STOREYS]
    storeys = Spring("storey", first, second, stiffness=stiffness, loss_factor=loss_factor)
    return Structure(nodes, [floors, storeys], ["0X"], active=["X"], bases=[Base("ground", "0X")])


def problem(values, structure=None, loads=("5X",), kind="accelerance", outputs=("1X", "2X", "3X", "4X", "5X"), seed=0):
    """A problem whose start is `values` times the truth; 1 % noise, stated."""
    true = shear_frame() if structure is None else structure
    unknown = parameters(true, [Unknown("mass", "floor"), Unknown("stiffness", "storey", each=True)])
    blank = np.zeros((len(FREQUENCY), len(outputs), len(loads)), complex)
    record = simulated_record(true, unknown, FrfRecord(FREQUENCY, blank, outputs, loads, kind))
    rng = np.random.default_rng(seed)
    error = rng.standard_normal(blank.shape) + 1j * rng.standard_normal(blank.shape)
    noisy = record.values * (1 + 0.01 * error / np.sqrt(2))
    measured = replace(record, values=noisy, variance=(0.01 * abs(record.values)) ** 2)
    return FrfProblem(true, unknown.started_at(np.array(unknown.start) * values), measured)


def far(seed):
    """Six factors, each 15 to 30 % off."""
    rng = np.random.default_rng(seed)
    return 1 + rng.choice([-1, 1], 6) * rng.uniform(0.15, 0.3, 6)


def told(made):
    return channel_warnings(aligned(made, made.predicted(np.asarray(made.theta_start)))).words


def with_values(made, change):
    values = np.array(made.record.values)
    change(values)
    return replace(made, record=replace(made.record, values=values, variance=(0.01 * abs(values)) ** 2 + 1e-20))


def test_right_models_that_start_far_off_are_silent():
    assert [words for seed in range(40) for words in told(problem(far(seed), seed=seed))] == []


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (3.0, "support 0X+: its motion is 3 times what the record says"),
        (0.1, "support 0X+: its motion is 1/10 times what"),
        (-1.0, "the support 0X+ moves with the opposite sense"),
    ],
)
def test_the_motion_of_a_support_is_no_force(factor, words):
    """And no mass: motion per motion knows of none. What the model comes to explain is not said of it."""
    made = problem(1.0, loads=("0X",), kind="transmissibility")
    assert told(made) == ()
    made = with_values(made, lambda values: np.multiply(values, factor, out=values))
    found = channel_warnings(aligned(made, made.predicted(np.asarray(made.theta_start))))
    assert found.of_loads == ()
    [one] = found.of_sensors
    assert words in one
    assert "force" not in one


@pytest.mark.parametrize(
    ("factor", "start", "words"),
    [
        (
            4.448,
            "support 6X+: the measured transmissibility is 4.4 times the model's beside other supports",
            "its sensor",
        ),
        (-1.0, "support 6X+ moves with the opposite sense", "relabel it"),
    ],
)
def test_the_motion_of_one_support_of_two_is_no_force(factor, start, words):
    """A frame between two supports, each a base of its own."""
    bare = shear_frame()
    storeys = Spring(
        "storey", [f"{i}X" for i in range(1, 7)], [f"{i}X" for i in range(6)], stiffness=1.5e6, loss_factor=0.03
    )
    bases = [Base("ground", "0X"), Base("roof", "6X")]
    nodes = {i: (float(i), 0.0) for i in range(7)}
    held = Structure(nodes, [bare.elements[0], storeys], ["0X", "6X"], active=["X"], bases=bases)
    made = problem(1.0, held, loads=("0X", "6X"), kind="transmissibility")
    assert told(made) == ()
    found = told(with_values(made, times(factor, i=1)))
    [one] = [one for one in found if one.startswith(start)]
    assert words in one
    assert not any("force" in one or "load" in one for one in found)


@pytest.mark.parametrize("loads", [("5X", "2X"), ("1X", "3X", "5X")])
def test_right_models_with_several_loads_are_silent(loads):
    assert [words for seed in range(12) for words in told(problem(far(seed), loads=loads, seed=seed))] == []


def times(factor, o=slice(None), i=slice(None)):
    def change(values):
        values[:, o, i] *= factor

    return change


CASES = [
    (times(9.80665, 2), "sensor 3X+ reads", "in m/s^2 and read as g"),
    (times(1 / 9.80665, 2), "sensor 3X+ reads 1/", "in g and read as m/s^2"),
    (times(1e3, 0), "sensor 1X+ reads", "in mm and read as m"),
    (times(5.6, 1), "sensor 2X+ reads", ""),
    (times(-1, 3), "sensor 4X+ reads with the opposite sense", 'relabel = {"4X" = "4X-"}'),
    (times(5.0), "load 5X+: the force is ", "times what the record says"),
    (times(1e-3), "", "00"),
]


@pytest.mark.parametrize("change, start, words", CASES)
def test_a_fault_is_named_from_most_starts_far_off_and_nothing_else_is(change, start, words):
    every = [told(with_values(problem(far(seed), seed=seed), change)) for seed in range(20)]
    assert all(found.startswith(start) for one in every for found in one if "close to 9.81" not in found)
    assert sum(words in found for one in every for found in one) >= 15


@pytest.mark.parametrize(
    "factor, words", [(4.448, "in lbf and read as N"), (1 / 4.448, "in N and read as lbf"), (1e-3, "close to 10^-3")]
)
def test_the_unit_of_the_force_is_told_where_all_sensors_agree(factor, words):
    rng = np.random.default_rng(11)
    for seed in range(5):
        [found] = told(with_values(problem(rng.uniform(0.95, 1.05, 6), seed=seed), times(factor)))
        assert words in found


@pytest.mark.parametrize("kind", ["mobility", "receptance"])
def test_other_kinds_are_held_alike(kind):
    assert told(problem(far(3), kind=kind)) == ()
    [found] = told(with_values(problem(far(3), kind=kind), times(-1, 1)))
    assert "sensor 2X+ reads with the opposite sense" in found


def test_two_exchanged_sensors_are_named():
    def change(values):
        values[:, [0, 3]] = values[:, [3, 0]]

    [found] = told(with_values(problem(far(5)), change))
    assert found.startswith("sensors 1X+ and 4X+ look exchanged")


def test_a_load_of_several_is_named():
    made = problem(far(6), loads=("5X", "3X", "1X"))
    assert any(words.startswith("load 3X+") and "lbf" in words for words in told(with_values(made, times(4.448, i=1))))
    turned = told(with_values(made, times(-1, i=1)))
    assert any(words.startswith("load 3X+ acts with the opposite sense") for words in turned)


@pytest.mark.parametrize("loads", [("5X", "2X"), ("5X", "3X", "1X")])
def test_loads_that_are_off_alike_are_told_together_and_not_beside_each_other(loads):
    """All accelerations are in g and read as m/s^2; of two loads the one that is off differs from the other."""
    together = []
    for seed in range(7):
        made = problem(far(seed), loads=loads, seed=seed)
        together += told(with_values(made, times(1 / STANDARD_GRAVITY)))
        alone = told(with_values(made, times(4.448, i=1)))
        assert [words.split(":")[0] for words in alone if words.startswith("load")] == [f"load {loads[1]}+"]
    assert len(together) >= 5
    assert all("accelerations look to be in g and were read as m/s^2" in words for words in together)


@pytest.mark.parametrize(("loads", "is_told"), [(("5X", "2X"), True), (("5X",), False)])
def test_a_factor_far_off_on_which_loads_agree_needs_half_of_the_resonances_only(loads, is_told):
    """Where a resonance of two has no like, parameters that start far off give no such factor at two loads."""
    made = with_values(problem(far(4), loads=loads), times(1 / STANDARD_GRAVITY))
    comparison = aligned(made, made.predicted(np.asarray(made.theta_start)))
    both = [pair for pair in comparison.pairs if np.isfinite(pair.mac)]
    half = replace(comparison, pairs=(*both, *[ResonancePair(1.0, np.nan, np.nan)] * len(both)))
    assert any("in g and were read as m/s^2" in words for words in channel_warnings(half).words) == is_told
    fewer = replace(comparison, pairs=(*half.pairs, ResonancePair(1.0, np.nan, np.nan)))
    assert channel_warnings(fewer).of_loads == ()


def test_the_sense_of_the_only_load_is_named_where_it_is_not_measured():
    made = problem(far(7), outputs=("1X", "2X", "3X", "4X"))
    [found] = told(with_values(made, times(-1)))
    assert "all sensors move against the model: the load 5X+ acts with the opposite sense" in found


def test_reciprocity_needs_no_model():
    """Both driven and measured; the start is far too bad for anything else to be told."""
    made = problem(np.array([3.0, 0.2, 4.0, 0.3, 5.0, 0.1]), loads=("5X", "2X"))
    assert told(made) == ()
    [found] = told(with_values(made, times(1.2, 1)))
    assert "reciprocity: 5X under a load at 2X is 0.833 times 2X under a load at 5X" in found
    assert any(
        words.startswith("reciprocity: 5X under a load at 2X is -") for words in told(with_values(made, times(-1, 1)))
    )


def tower(force, stiffness, seed=0):
    """A tower whose force is `force` times what its record says, beside a model `stiffness` times too stiff."""
    rng = np.random.default_rng(seed)
    made = problem(np.array([1.0, *np.full(5, stiffness) * rng.uniform(0.9, 1.1, 5)]), seed=seed)
    return with_values(made, times(force))


@pytest.mark.parametrize("stiffness", [0.3, 0.5, 1.0, 2.0, 3.0])
def test_a_force_that_is_too_small_in_the_record_points_at_the_load_and_not_at_units(stiffness):
    """The level of all lines goes with stiffness too: taken as it is, it is 4 to 15 times the model's, as g for m/s^2."""
    [found] = told(tower(1.8, stiffness))
    assert found.startswith("load 5X+: the force is 1.")
    factor = float(found.split("is ")[1].split(" times")[0])
    assert factor == pytest.approx(1.8, rel=0.06)
    assert "in g" not in found


def test_noise_without_a_word_about_it_says_nothing():
    """Lines that hold noise alone have no phase in common with the model."""
    made = problem(far(8))
    rng = np.random.default_rng(0)
    shape = made.record.values.shape
    noise = 30 * abs(made.record.values).max() * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    assert told(replace(made, record=replace(made.record, values=noise, variance=None), model_error=0.1)) == ()


def test_a_dead_channel_and_a_single_sensor_are_no_crash():
    made = problem(far(9))
    assert told(with_values(made, times(1e-20, 2))) == ()
    hidden = replace(made, record=replace(made.record, variance=np.full(made.record.values.shape, 1e12)))
    assert told(hidden) == ()
    assert told(problem(far(9), outputs=("1X",))) == ()
    for keep in (0, 1):
        of_load = np.full((*made.record.values.shape[:2], 2), 1e12)
        of_load[..., keep] = 1e-12
        two = problem(far(9), loads=("5X", "2X"))
        assert told(replace(two, record=replace(two.record, variance=of_load))) == ()
    alone = np.full(made.record.values.shape, 1e12)
    alone[:, 2] = 1e-12
    assert told(replace(made, record=replace(made.record, variance=alone))) == ()


def test_things_in_order_are_paired_as_cheaply_as_can_be():
    """Against all pairings of small tables, by search."""

    def best(cost):
        n, m = cost.shape
        if not n or not m:
            return 0.4 * (n + m)
        return min(best(cost[1:, 1:]) + cost[0, 0], best(cost[1:]) + 0.4, best(cost[:, 1:]) + 0.4)

    rng = np.random.default_rng(0)
    for n, m in ((0, 3), (1, 1), (3, 4), (5, 3)):
        cost = rng.random((n, m))
        pairs, told_cost = in_order(cost, 0.4)
        total = sum(cost[i, j] if i is not None and j is not None else 0.4 for i, j in pairs)
        assert total == pytest.approx(best(cost))
        assert told_cost == pytest.approx(total)
        assert [i for i, _ in pairs if i is not None] == list(range(n))
        assert [j for _, j in pairs if j is not None] == list(range(m))


def test_resonances_are_paired_by_shape_and_the_missing_ones_left_alone():
    """The band ends between the model's second and third mode, and the record has one mode more."""
    made = problem(np.array([1.0, *np.full(5, 1.3)]))
    pairs = resonance_pairs(made.record, made.predicted(np.asarray(made.theta_start)))
    both = [pair for pair in pairs if np.isfinite(pair.mac)]
    assert len(both) >= 4
    np.testing.assert_allclose([p.model / p.measured for p in both], np.sqrt(1.3), rtol=0.01)
    assert all(pair.mac > 0.99 for pair in both)
    short = replace(made, record=made.record.band(2.0, 35.0))
    pairs = resonance_pairs(short.record, short.predicted(np.asarray(short.theta_start)))
    lost = [pair for pair in pairs if np.isnan(pair.model)]
    assert len(lost) == 1
    assert lost[0].measured > 30


def test_beams_with_rotations_measured():
    nodes = {i: (i / 4, 0.0) for i in range(5)}
    beam = Beam(
        "beam", [[i, i + 1] for i in range(4)], mass=2.0, bending_stiffness=400.0, axial_stiffness=1e6, loss_factor=0.02
    )
    structure = Structure(nodes, [beam], ["0X", "0Y", "0RZ"])
    unknown = parameters(structure, [Unknown("bending_stiffness", "beam", each=True)])
    outputs = ("1Y", "2Y", "3Y", "4RZ")
    frequency = np.arange(2.0, 150.0, 0.5)
    blank = FrfRecord(frequency, np.zeros((len(frequency), 4, 1), complex), outputs, ("4Y",), "receptance")
    record = simulated_record(structure, unknown, blank)
    made = FrfProblem(
        structure, unknown.started_at(np.array(unknown.start) * [1.2, 0.8, 1.1, 0.9]), record, model_error=0.1
    )
    assert told(made) == ()
    [found] = told(with_values(made, times(180 / np.pi, 3)))
    assert found.startswith("sensor 4RZ+ reads")
    assert "in deg and read as rad" in found


def test_sensors_that_no_load_moves_are_left_alone():
    """Across the load the model stands still, and what is read there is noise."""
    nodes = {i: (float(i), 0.0) for i in range(6)}
    floors = PointMass("floor", list(STOREYS), 100.0, directions=["X", "Y"])
    pairs = [(f"{i}{d}", f"{i - 1}{d}") for d in "XY" for i in STOREYS]
    storeys = Spring("storey", *map(list, zip(*pairs, strict=True)), stiffness=1.5e6, loss_factor=0.03)
    both = Structure(nodes, [floors, storeys], ["0X", "0Y"], active=["X", "Y"])
    made = problem(1.0, both, outputs=("1X", "2X", "3X", "4X", "5X", "3Y"))
    values, variance = np.array(made.record.values), np.array(made.record.variance)
    assert np.abs(values[:, 5]).max() < 1e-12 * np.abs(values).max()
    rng = np.random.default_rng(1)
    values[:, 5, 0] = rng.standard_normal(len(values)) + 1j * rng.standard_normal(len(values))
    variance[:, 5] = 0.01
    silent = replace(made, record=replace(made.record, values=values, variance=variance))
    assert told(silent) == ()


def test_reciprocity_is_not_looked_for_in_noise():
    """Cross FRFs that are noise alone, as in symmetric structures, differ from one another by any factor."""
    made = problem(1.0, loads=("5X", "2X"))
    rng, values = np.random.default_rng(4), np.array(made.record.values)
    variance = (0.01 * abs(values)) ** 2
    for o, i, size in ((1, 0, 1e-6), (4, 1, 1e-5)):
        values[:, o, i] = size * (rng.standard_normal(len(values)) + 1j * rng.standard_normal(len(values)))
        variance[:, o, i] = 2 * size**2
    noisy = replace(made, record=replace(made.record, values=values, variance=variance))
    assert not any(words.startswith("reciprocity") for words in told(noisy))


@pytest.mark.parametrize(
    ("size", "told"),
    [
        ([[1.0, 0.05], [0.06, 1.0], [0.7, 0.8]], [[1, 0], [0, 1], [1, 1]]),  # two ends of a car, and its middle
        ([[1.0, 0.01], [2.0, 0.03], [0.5, 0.004]], [[1, 1], [1, 1], [1, 1]]),  # a load that moves all by little
        ([[1.0], [0.01]], [[1], [1]]),
    ],
)
def test_what_is_left_where_motions_cancel_does_not_tell_of_its_sensor(size, told):
    model = np.array(size) * np.ones((40, 1, 1), complex)
    assert (_can_judge(model, model.copy()) == np.array(told, bool)).all()


def test_a_single_clear_line_does_not_tell_of_its_sensor():
    measured = np.ones((40, 2, 1), complex)
    measured[1:, 1] = np.nan
    assert _can_judge(np.ones((40, 2, 1), complex), measured).tolist() == [[True], [False]]
