"""Motion of all degrees of freedom from records: signs, ties, integration by a stated rule, and what is missing."""

from dataclasses import replace

import numpy as np
import pytest

from structid import Beam, InputError, PointMass, RigidLink, Spring, Structure, TimeRecord
from structid.forward import Motion, completed, identify_motion, recorded_motion
from structid.forward.motion.motion import MOTION_QUANTITIES
from structid.unknowns import Unknown
from structid.unknowns.parameters import parameters

RATE = 100.0


def chain():
    """Two masses on springs, motions 1X and 2X."""
    parts = [
        PointMass("mass", [1, 2], [2.0, 3.0]),
        Spring("spring", "1X", "2X", stiffness=5.0),
        Spring("base", "1X", stiffness=7.0),
    ]
    return Structure({1: 0.0, 2: 1.0}, parts, active=["X"])


def record(n=40, quantities=MOTION_QUANTITIES, signs=("1X+", "2X+"), seed=0):
    rng = np.random.default_rng(seed)
    channels = [dof for _ in quantities for dof in signs]
    names = [name for name in quantities for _ in signs]
    return TimeRecord(RATE, rng.standard_normal((n, len(channels) + 1)), (*channels, "2X"), (*names, "force"))


def test_channels_reach_their_degrees_of_freedom_with_signs():
    structure = chain()
    made = recorded_motion(structure, record(signs=("2X-", "1X+")))
    values = record().values
    assert [str(d) for d in structure.dofs] == ["1X+", "2X+"]
    for i, name in enumerate(MOTION_QUANTITIES):
        assert getattr(made, name) == pytest.approx(values[:, [2 * i + 1, 2 * i]] * [1, -1], rel=1e-12)
    assert made.force == pytest.approx(np.column_stack([np.zeros(40), values[:, 6]]))
    assert made.time == pytest.approx(np.arange(40) / RATE)


def test_repeated_view_of_one_motion_through_a_rigid_link_is_averaged():
    parts = [PointMass("mass", [1], 2.0), Spring("base", "1X", stiffness=7.0), PointMass("far", [2], 1.0)]
    structure = Structure({1: 0.0, 2: 1.0}, parts, ties=[RigidLink("link", 1, 2)], active=["X"])
    made = recorded_motion(structure, record(signs=("1X+", "2X-")))
    values = record().values
    assert made.displacement == pytest.approx(0.5 * (values[:, [4]] - values[:, [5]]), rel=1e-12)
    assert made.force == pytest.approx(values[:, [6]])


def test_trapezoid_is_exact_for_accelerations_in_straight_lines_and_second_order_otherwise():
    time = np.array([0.0, 0.1, 0.4, 0.5, 0.9])
    a = np.stack([3 + 2 * time, -time], axis=1)
    made = completed(Motion(time, 0 * a, a), "trapezoid", [1.0, 2.0], [0.5, -0.5])
    assert made.velocity == pytest.approx(np.stack([0.5 + 3 * time + time**2, -0.5 - time**2 / 2], axis=1), abs=1e-14)
    errors = []
    for n in (50, 100):
        t = np.linspace(0, 2, n + 1)[:, None]
        twice = completed(Motion(t[:, 0], 0 * t, -np.sin(t)), "trapezoid", initial_velocity=[1.0])
        errors.append(np.abs(twice.displacement - np.sin(t)).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)


def test_integrated_noise_is_the_random_walk_that_the_notes_say():
    """4000 records of unit noise, 400 steps of 0.01 s: standard deviations within 5 % (chance: 1.1 %)."""
    noise = np.random.default_rng(4).standard_normal((401, 4000))
    made = completed(Motion(np.arange(401) * 0.01, 0 * noise, noise), "trapezoid")
    assert made.velocity[400].std() == pytest.approx(0.01 * 400**0.5, rel=0.05)
    assert made.displacement[400].std() == pytest.approx(0.01**2 * (400**3 / 3) ** 0.5, rel=0.05)
    assert completed(Motion(made.time, 0 * noise, None, None, noise), "difference").acceleration.std() == pytest.approx(
        6**0.5 / 0.01**2, rel=0.01
    )


def test_differences_are_exact_for_parabolas_and_lose_the_ends():
    time = np.arange(6) * 0.2
    w = np.stack([1 + 2 * time + 3 * time**2], axis=1)
    made = completed(Motion(time, w, None, None, w), "difference")
    assert made.time == pytest.approx(time[1:-1])
    assert made.velocity[:, 0] == pytest.approx(2 + 6 * time[1:-1], abs=1e-12)
    assert made.acceleration[:, 0] == pytest.approx(6.0, abs=1e-11)
    assert made.displacement == pytest.approx(w[1:-1])
    assert made.force == pytest.approx(w[1:-1])


def test_what_is_measured_is_kept_when_the_rest_is_made():
    made = recorded_motion(chain(), record(quantities=("acceleration", "displacement")), rule="trapezoid")
    values = record(quantities=("acceleration", "displacement")).values
    assert made.displacement == pytest.approx(values[:, 2:4])
    assert made.velocity[1] == pytest.approx((values[0, :2] + values[1, :2]) / 2 / RATE)


def test_unequal_instants_serve_where_everything_is_measured():
    """The equations hold at each instant by itself."""
    structure = chain()
    made = recorded_motion(structure, record())
    some = made.at([0, 3, 4, 11, 30])
    assert some.n_times == 5
    mass, stiffness = (structure.matrix(kind).toarray() for kind in ("mass", "stiffness"))
    exact = replace(some, force=some.acceleration @ mass + some.displacement @ stiffness)
    unknown = parameters(
        structure,
        [Unknown("mass", "mass", each=True), Unknown("stiffness", ["spring"]), Unknown("stiffness", ["base"])],
    )
    assert identify_motion(structure, unknown, exact).values == pytest.approx([2.0, 3.0, 5.0, 7.0], rel=1e-12)


def beam():
    return Structure({0: 0.0, 1: 1.0}, [Beam("beam", [[0, 1]], 1.0, 1.0)], ["0Y", "0RZ"])


def plate():
    """A rigid plate with places along one straight line, which do not show how it turns about that."""
    parts, places = (
        [PointMass("mass", [1], 1.0), Spring("base", "1Z", stiffness=1.0)],
        [(0.1, 0.3), (0.2, 0.6), (0.7, 2.1)],
    )
    nodes = {1: (0.0, 0.0, 0.0)} | {i: (*place, 0.0) for i, place in enumerate(places, 2)}
    return Structure(nodes, parts, ties=[RigidLink("plate", 1, [2, 3, 4])], active=["Z", "RX", "RY"])


BAD = {
    "rotation not measured": (
        lambda: recorded_motion(beam(), TimeRecord(RATE, np.ones((5, 2)), ("1Y", "1Y"), ("acceleration", "force"))),
        "acceleration is not measured at 1RZ.*Add sensors there",
    ),
    "rotation about the line of all sensors": (
        lambda: recorded_motion(
            plate(), TimeRecord(RATE, np.ones((5, 4)), ("2Z", "3Z", "4Z", "1Z"), (*("velocity",) * 3, "force"))
        ),
        "the velocity channels do not determine every degree of freedom: tied ones",
    ),
    "no motion": (
        lambda: recorded_motion(chain(), TimeRecord(RATE, np.ones((5, 1)), ("1X",), ("force",))),
        "holds no motion",
    ),
    "no force": (
        lambda: recorded_motion(chain(), TimeRecord(RATE, np.ones((5, 2)), ("1X", "2X"), ("velocity",) * 2)),
        "no force channel.*give `force` \\(5, 2\\)",
    ),
    "two forces": (lambda: recorded_motion(chain(), record(), force=np.zeros((40, 2))), "one or the other"),
    "force of another shape": (
        lambda: recorded_motion(
            chain(), TimeRecord(RATE, np.ones((5, 2)), ("1X", "2X"), ("velocity",) * 2), force=np.zeros((5, 3))
        ),
        "`force` must have shape",
    ),
    "nothing to integrate": (
        lambda: recorded_motion(chain(), record(quantities=("velocity",)), "trapezoid"),
        "starts from acceleration, which is missing",
    ),
    "nothing to differentiate": (
        lambda: recorded_motion(chain(), record(quantities=("acceleration",)), "difference"),
        "starts from displacement, which is missing",
    ),
    "unequal steps": (
        lambda: completed(Motion([0, 1, 3], np.ones((3, 1)), None, None, np.ones((3, 1))), "difference"),
        "needs equal steps, got 1 to 2 s; resample",
    ),
    "two samples": (
        lambda: completed(Motion([0, 1], np.ones((2, 1)), None, None, np.ones((2, 1))), "difference"),
        "at least 3 samples, got 2",
    ),
    "unknown rule": (lambda: recorded_motion(chain(), record(), "simpson"), "`rule` must be"),
    "initial value of another shape": (
        lambda: recorded_motion(chain(), record(quantities=("acceleration",)), "trapezoid", None, [1.0]),
        "`initial_displacement` must have shape",
    ),
    "initial value not used": (
        lambda: recorded_motion(chain(), record(), "trapezoid", None, [1.0, 1.0]),
        "`initial_displacement` is not used",
    ),
    "initial velocity not used": (
        lambda: recorded_motion(chain(), record(), "trapezoid", None, None, [1.0, 1.0]),
        "`initial_velocity` is not used",
    ),
    "initial value and differences": (
        lambda: recorded_motion(chain(), record(), "difference", None, [1.0, 1.0]),
        "belong to rule 'trapezoid'",
    ),
    "time runs back": (lambda: Motion([0, 1, 1], np.ones((3, 1))), "must increase"),
    "shapes differ": (lambda: Motion([0, 1], np.ones((2, 1)), np.ones((2, 2))), "`acceleration` must have shape"),
    "not a number": (lambda: Motion([0], [[1.0]], [[np.nan]]), "`acceleration` must be finite"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_with_what_is_missing(case):
    act, words = BAD[case]
    with pytest.raises(InputError, match=words):
        act()
