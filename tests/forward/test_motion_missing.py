"""What identification from motion says where information is missing, and what it refuses."""

import numpy as np
import pytest
from motion_cases import EVERYTHING, cantilever, free_beam, moved

from structid import (
    Beam,
    InputError,
    PointMass,
    Prior,
    Spring,
    Status,
    Structure,
    Unknown,
    parameters,
)
from structid.fem import Friction
from structid.forward import Motion, identify_motion
from structid.forward.motion.fit import motion_fit


def rigid(noise=0.0):
    """A free beam that only translates and turns, under the forces that this takes."""
    structure, time = free_beam(), np.linspace(0, 2, 50)
    modes = np.array([[1, 0, 1, 0, 1, 0], [0, 1, 1, 1, 2, 1.0]])
    w = np.stack([np.sin(time), np.cos(2 * time)], axis=1) @ modes
    a = np.stack([-np.sin(time), -4 * np.cos(2 * time)], axis=1) @ modes
    rng = np.random.default_rng(0)
    return structure, Motion(time, a @ structure.matrix("mass"), a, None, w + noise * rng.standard_normal(w.shape))


def test_rigid_body_motion_gives_masses_and_says_what_stiffness_needs():
    structure, motion = rigid()
    unknown = parameters(structure, EVERYTHING[:2])
    found = identify_motion(structure, unknown, motion)
    assert found.status is Status.NOT_IDENTIFIABLE
    assert found.values[:2] == pytest.approx([2.0, 3.0], rel=1e-10)
    assert np.isnan(found.values[2:]).all()
    assert found.identified.tolist() == [True, True, False, False]
    assert "bending_stiffness[beam:1], bending_stiffness[beam:2]: the motion does not strain" in found.message
    assert "excite an elastic mode" in found.message
    assert [d.words for d in found.identifiability.directions] == [
        "bending_stiffness[beam:1] not at all",
        "bending_stiffness[beam:2] not at all",
    ]


def test_noise_does_not_pass_for_strain_where_its_size_is_given():
    structure, motion = rigid(noise=1e-3)
    unknown = parameters(structure, EVERYTHING[:2])
    found = identify_motion(structure, unknown, motion, variance={"displacement": 1e-6})
    assert found.status is Status.NOT_IDENTIFIABLE
    assert found.identified.tolist() == [True, True, False, False]
    assert "does not rise above its noise for bending_stiffness[beam:1], bending_stiffness[beam:2]" in found.message


def test_too_few_samples_say_how_many_are_needed():
    structure = cantilever()
    found = identify_motion(structure, parameters(structure, EVERYTHING[:3]), moved(structure).at([20]))
    assert found.status is Status.NOT_IDENTIFIABLE
    assert "1 samples of 8 degrees of freedom give 8 equations for 12 parameters; at least 2 samples" in found.message


def test_rank_deficiency_is_named():
    """Steady motion of one mass at one frequency: mass and stiffness only as k - omega^2 m."""
    parts = [PointMass("mass", [1], 2.0), Spring("spring", "1X", stiffness=20.0)]
    structure = Structure({1: 0.0}, parts, active=["X"])
    unknown = parameters(structure, [Unknown("mass", "mass"), Unknown("stiffness", "spring")])
    time = np.linspace(0, 3, 40)
    w = np.cos(2 * time)[:, None]
    found = identify_motion(structure, unknown, Motion(time, (20 - 4 * 2) * w, -4 * w, None, w))
    assert found.status is Status.NOT_IDENTIFIABLE
    assert np.isnan(found.values).all()
    assert "rank 1 for 2 parameters; samples at other instants, a force at another place or of other" in found.message
    assert len(found.identifiability.directions) == 1


def test_as_many_equations_as_parameters_leave_no_covariance():
    structure = cantilever()
    unknown = parameters(structure, [*EVERYTHING[:2]])
    found = identify_motion(structure, unknown, moved(structure).at([30]))
    assert found.values == pytest.approx(unknown.start, rel=1e-6)
    assert np.isnan(found.std).all()
    assert "no residual is left" in found.message


def test_values_outside_their_range_are_named_not_forced():
    structure = cantilever()
    unknown = parameters(structure, EVERYTHING[:2])
    motion = moved(structure)
    found = identify_motion(
        structure,
        unknown,
        Motion(motion.time, -motion.force, motion.acceleration, motion.velocity, motion.displacement),
    )
    assert (found.values < 0).all()
    assert "outside the declared range: mass[beam:1]" in found.message


def test_parameters_that_the_bias_swamps_are_not_identified():
    """Displacement noise of 1.2 times the motion: 0.6 of the stiffness is lost, and its own interval is blind to it."""
    parts = [PointMass("mass", [1], 2.0), Spring("spring", "1X", stiffness=20.0)]
    structure = Structure({1: 0.0}, parts, active=["X"])
    unknown = parameters(structure, [Unknown("stiffness", "spring")])
    motion = moved(structure, n=5000, loads=(0,))
    std = 1.25 * np.sqrt((motion.displacement**2).mean())
    noise = std * np.random.default_rng(0).standard_normal(motion.force.shape)
    noisy = Motion(motion.time, motion.force, motion.acceleration, None, motion.displacement + noise)
    silent = identify_motion(structure, unknown, noisy)
    found = identify_motion(structure, unknown, noisy, variance={"displacement": std**2})
    assert silent.status is Status.CONVERGED
    assert found.values[0] == pytest.approx(20 / (1 + 1.25**2), rel=0.1)
    assert found.status is Status.NOT_IDENTIFIABLE
    assert not found.identified[0]


def damped_by_loss():
    beam = Beam("beam", [[0, 1]], 1.0, 1.0, loss_factor=0.01)
    return Structure({0: 0.0, 1: 1.0}, [beam], ["0Y", "0RZ"])


def rubbing():
    parts = [
        PointMass("mass", [1], 2.0),
        Spring("spring", "1X", stiffness=20.0),
        Friction("rub", "1X", friction_force=1.0),
    ]
    return Structure({1: 0.0}, parts, active=["X"])


def act(structure, unknowns, motion, **options):
    return identify_motion(structure, parameters(structure, unknowns), motion, **options)


def changed(**fields):
    motion = moved(cantilever())
    names = ("time", "force", "acceleration", "velocity", "displacement")
    return Motion(**({name: getattr(motion, name) for name in names} | fields))


NOTHING = np.zeros((60, 8))


MASS = [Unknown("mass", "beam", each=True)]


BAD = {
    "loss factor": (lambda: act(damped_by_loss(), MASS, moved(free_beam())), "loss factors have no equation"),
    "friction": (lambda: act(rubbing(), [Unknown("mass", "mass")], moved(free_beam())), "friction 'rub' is not linear"),
    "priors": (
        lambda: act(cantilever(), [Unknown("mass", "beam:1", prior=Prior(1.0, 0.1))], changed()),
        "priors need a known noise level",
    ),
    "no acceleration": (
        lambda: act(cantilever(), MASS, changed(acceleration=None)),
        "acceleration is missing, and the structure has mass",
    ),
    "no velocity": (
        lambda: act(cantilever(), MASS, changed(velocity=None)),
        "velocity is missing, and the structure has viscous damping; measure it, or make it",
    ),
    "no motion": (
        lambda: act(cantilever(), MASS, changed(acceleration=NOTHING, velocity=NOTHING, displacement=NOTHING)),
        "the force excites nothing; check the channels",
    ),
    "no force": (
        lambda: act(cantilever(), EVERYTHING, changed(force=NOTHING)),
        "force is zero in every sample.*ratios of parameters only; apply and record a force, or fix",
    ),
    "another structure": (lambda: act(free_beam(), MASS, changed()), "must have 6 degrees of freedom, got 8"),
    "rule for a motion": (
        lambda: act(cantilever(), MASS, changed(), rule="trapezoid"),
        "`rule` belongs to a TimeRecord",
    ),
    "weights of another shape": (
        lambda: act(cantilever(), MASS, changed(), row_weights=[1.0]),
        "`row_weights` must have shape",
    ),
    "weights all zero": (
        lambda: act(cantilever(), MASS, changed(), row_weights=np.zeros(8)),
        "none negative and not all 0",
    ),
    "variance of what": (
        lambda: act(cantilever(), MASS, changed(), variance={"force": 1.0}),
        "`variance` must be of acceleration, velocity, displacement, got 'force'",
    ),
    "variance of another shape": (
        lambda: act(cantilever(), MASS, changed(), variance={"velocity": np.ones(3)}),
        "`variance` of velocity must be one number",
    ),
    "negative variance": (
        lambda: act(cantilever(), MASS, changed(), variance={"velocity": -1.0}),
        "finite and not negative",
    ),
    "no samples": (
        lambda: motion_fit(cantilever(), parameters(cantilever(), MASS)).estimate(),
        "there are no samples yet",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_with_what_would_help(case):
    run, words = BAD[case]
    with pytest.raises(InputError, match=words):
        run()
