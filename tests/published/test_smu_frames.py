"""Measured modes of two shear frames against their published stiffnesses (numbers under GPL-3, kept outside the package)."""

from pathlib import Path

import numpy as np
import pytest

from structid import ModalRecord, PointMass, Spring, Structure, Unknown, estimate, parameters
from structid.dynamics.normal_modes import modes
from structid.forward import ModalProblem, ModalSettings

FRAMES = Path(__file__).parents[3] / "shared" / "data" / "smu_shear_frames"
pytestmark = pytest.mark.skipif(
    not FRAMES.exists(),
    reason="the measured modes of the SMU frames are not part of the package: shared/data is missing",
)


def shear_chain(masses, stiffness):
    n = len(masses)
    here, below = [f"{i}X" for i in range(1, n + 1)], [f"{i}X" for i in range(n)]
    elements = [PointMass("floor", list(range(1, n + 1)), masses), Spring("story", here, below, stiffness=stiffness)]
    return Structure({i: float(i) for i in range(n + 1)}, elements, fixed=["0X"], active=["X"])


def test_four_story_stiffnesses_are_those_published_and_predict_the_modes_left_out():
    data = np.load(FRAMES / "four_story_lab_frame.npz")
    structure = shear_chain(data["floor_weight_lb"] / 386.088, 10.0)
    unknown = parameters(structure, [Unknown("stiffness", "story", each=True)])
    frequency = data["test_frequency_hz"]
    record = ModalRecord(frequency[:2], np.full(2, np.nan), data["test_mode"][:3, :2], ("1X", "2X", "3X"))
    problem = ModalProblem(structure, unknown, record, ModalSettings(frequency_error=0.002, shape_error=0.02))
    found = estimate(problem, plans=problem.schedules())
    published = 10 * (1 + data["published_alpha_form1_mac"])
    np.testing.assert_allclose(found.values, published, rtol=0.01)  # asked: 5 %
    values = unknown.values(found.values)
    predicted = modes(structure.matrix("mass", values), structure.matrix("stiffness", values)).frequency
    np.testing.assert_allclose(predicted[2:], frequency[2:], rtol=0.01)
    assert found.std[3] > 3 * found.std[0]  # the top story, beyond the sensors, is the least certain


def test_eighteen_story_frame_says_what_two_modes_at_six_floors_do_not_determine():
    data = np.load(FRAMES / "eighteen_story_edefense_frame.npz")
    structure = shear_chain(data["weight_kN"] / 9.8, data["nominal_story_stiffness_kN_per_m"])
    unknown = parameters(structure, [Unknown("stiffness", "story", each=True)])
    channels = tuple(f"{floor}X" for floor in (3, 6, 9, 12, 15, 18))
    record = ModalRecord(data["freq_hz"][:2], np.full(2, np.nan), data["mode_shape"][:, :2], channels)
    problem = ModalProblem(structure, unknown, record, ModalSettings(frequency_error=0.005, shape_error=0.02))
    found = estimate(problem, plans=problem.schedules())
    assert found.status.value == "not_identifiable"
    # two frequencies and two shapes of six entries are twelve numbers at most: six directions of eighteen stay free
    assert found.identifiability.rank <= 12
    assert all("story" in direction.words for direction in found.identifiability.directions)
