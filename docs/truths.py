"""Scripts of the gallery find the values that they say they find: the site build checks each script when it has run.

The scripts run once, when the site is built; the tests of `tests/test_gallery.py` read them only.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

GALLERY = Path(__file__).parents[1] / "examples" / "gallery"
#: Measured data that may not be distributed; scripts that need them say so where they are missing.
DATA = Path(__file__).parents[2] / "shared" / "data"


def near(answer: Any, deviations: float = 4.0, **truth: float) -> bool:
    """True where each parameter is within so many standard deviations of its true value."""
    estimate = getattr(answer, "estimate", answer)
    names = [name.replace("[", "_").replace("]", "").replace(":", "_").replace(" ", "_") for name in estimate.names]
    rows = [names.index(name) for name in truth]
    error = np.abs(estimate.values[rows] - list(truth.values()))
    return bool((error <= deviations * estimate.std[rows]).all())


def close(numbers: Any, expected: Any, relative: float = 0.0, absolute: float = 0.0) -> bool:
    """True where there are as many numbers as expected and each is as close as is said."""
    return np.shape(numbers) == np.shape(expected) and np.allclose(numbers, expected, rtol=relative, atol=absolute)


#: Scripts whose truth is known, with the condition on their names at the end.
def noise_deviation(found: Any, name: str) -> float:
    """The standard deviation of a parameter from noise alone."""
    return float(found.estimate.std_noise[found.estimate.names.index(name)])


HOLDS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "use/stress_on_a_mast": lambda end: (
        end["largest"].low[0] < end["largest"].values[0] < end["largest"].high[0]
        and end["damper"].peak < end["damper"].nominal_peak < end["damper"].peak_before
        and end["damper"].change.damping_ratio > end["damper"].nominal.damping_ratio
    ),
    "use/back_into_the_deck": lambda end: (
        len(end["changed"]) == 4
        and close(end["change"], [0.0] * 8 + [-0.15] * 8, absolute=0.02)
        and (np.abs(end["significance"][8:]) > 3).all()
    ),
    "use/control_of_a_free_beam": lambda end: (
        end["slowest"](end["truth"], end["regulate"](end["nominal"])) > 0
        and end["slowest"](end["truth"], end["regulate"](end["identified"])) < 0
        and (end["poles"] < 0).all()
    ),
    "records/roller_at_six_places": lambda end: (
        close((end["answer"] - end["places"]) / end["std"], np.zeros(6), absolute=4.0)
        and close(end["answer"], end["places"], absolute=3e-4)
    ),
    "commands/explain": lambda end: near(end["found"], bending_stiffness_beam=30.0, stiffness_support_0RZ=400.0),
    "commands/identify": lambda end: (
        near(end["found"], mass_tip=0.12) and noise_deviation(end["found"], "mass[tip]") < 1e-3
    ),
    "commands/convert": lambda end: close(
        end["record"].values[:, 1].max(), 9.80665 * end["readings"][:, 1].max(), relative=1e-6
    ),
    "records/frf_cantilever": lambda end: near(end["found"], mass_beam_4=1.2, bending_stiffness_beam_4=8.0),
    "records/histories_output_error": lambda end: near(end["found"], mass_mass_1=1.8, viscous_damping_damper_2=0.8),
    "records/histories_with_leakage": lambda end: (
        near(end["by_spectra"], stiffness_k_1=1000.0, stiffness_k_4=1000.0)
        and end["by_averages"]["viscous_damping[c]"].value > 1.1 * 0.7
        and near(end["by_spectra"], viscous_damping_c=0.7)
    ),
    "records/hammer_with_window": lambda end: near(
        end["found"], mass_mass_1=2.0, stiffness_spring_1=4e4, viscous_damping_damper_2=3.0
    ),
    "records/ambient_modes_to_stiffness": lambda end: (
        near(end["found"], stiffness_storey_1=2.4e6, stiffness_storey_4=1.1e6)
        and end["free"].estimate.status.value == "not_identifiable"
    ),
    "records/ambient_set_ups_merged": lambda end: (
        len(end["modes"].channels) == 8 and end["modes"].mode_shapes.shape[1] == 3
    ),
    "records/free_decay": lambda end: np.abs(end["errors"]).max() < 4,
    "elements/springs_dampers_friction": lambda end: near(end["found"], viscous_damping_oil=6.0),
    "elements/bars_of_a_truss": lambda end: near(end["found"], axial_stiffness_bar_7=3.2e6),
    "elements/beams_in_space": lambda end: near(end["found"], torsional_stiffness_column=2000.0),
    "elements/plate_every_element": lambda end: abs(end["change"].min() - end["soft"].min()) < 0.1,
    "elements/shells_of_a_roof": lambda end: near(end["found"], youngs_modulus_panel=68e9, thickness_panel=4.3e-3),
    "elements/solids": lambda end: near(end["found"], youngs_modulus_block=3.1e9, density_block=1180.0),
    "elements/membrane": lambda end: near(end["found"], mass_head=0.26, tension_head=2600.0),
    "elements/joints": lambda end: near(end["found"], stiffness_bolt=3e4, bending_stiffness_girder=2.1e4),
    "elements/matrices_of_another_code": lambda end: near(end["found"], stiffness_upper=0.9),
    "elements/component": lambda end: (
        near(end["identified"], stiffness_mount_1=2e4, stiffness_mount_3=1e4)
        and close(end["answers"]["reduced"].values, end["answers"]["whole"].values, relative=1e-4)
        and "changes the model's FRFs" in end["identified"].truncations[0].words
    ),
    "elements/tie_rod": lambda end: (
        near(end["found"], axial_force_rod=40e3, bending_stiffness_rod=3.34e3)
        and end["lowest"] < 0.101 * end["exact"][0]
    ),
    "elements/timoshenko_and_bernoulli": lambda end: (
        near(end["found"], bending_stiffness_beam=1.1e5, shear_stiffness_beam=1.3e7)
        and end["without"].estimate.chi_square_per_dof > 1e3
    ),
    "elements/solver_in_the_loop": lambda end: "found" not in end or end["found"].estimate.status.value == "converged",
    "records/base_excitation": lambda end: near(end["found"], stiffness_storey_1=5.2e5, viscous_damping_loss_2=700.0),
    "records/table_of_a_laboratory": lambda end: close(end["modes"].frequency, [6.0], absolute=0.01),
    "trust/swapped_cables": lambda end: near(end["found"], stiffness_spring_1=1000.0, stiffness_spring_3=1000.0),
    "trust/wrong_unit": lambda end: near(end["found"], bending_stiffness_beam=80.0, **{"gain_3Y+": 1 / 9.80665}),
    "trust/priors": lambda end: near(end["found"], mass_mass_2=3.0, gain_sensors=1.0),
    "trust/regularization": lambda end: (
        not end["alone"].identified.any() and np.max(end["smooth"].std / end["smooth"].values) < 0.1
    ),
    "trust/bounds": lambda end: [one.side for one in end["found"].estimate.spread.at_bound] == ["lower"],
    "trust/what_varies": lambda end: (
        near(end["found"], bending_stiffness_strip=40.0) and len(end["found"].priors.varied) == 1
    ),
    "trust/several_states": lambda end: list(end["found"].changed) == [True, False, True, False],
    "trust/intervals": lambda end: np.isinf(end["curve"].upper) and end["curve"].lower < 3e4,
    "benchmarks/iasc_asce": lambda end: list(end["found"].changed[:4]) == [True, False, True, False],
    "benchmarks/palisaden": lambda end: (
        close(end["modes"].frequency[:3], [1.8820, 2.4217, 2.6870], absolute=0.01)
        and (end["modes"].frequency[3:] > 3).all()  # the published list ends with the third
    ),
    "benchmarks/smu_frame": lambda end: (
        "found" not in end or near(end["found"], 2.0, stiffness_storey_1=7.397 * 4.4482216 / 0.0254)
    ),
    "benchmarks/garteur": lambda end: np.abs(end["after"] / end["measured"] - 1).max() < 0.008,
    "benchmarks/nist_regression": lambda end: close(end["found"].values, end["certified"], relative=1e-7),
}


#: The script that runs in this process, by its name in the gallery, with its names and their values.
_running: dict[str, dict[str, Any]] = {}


def keep_names(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Keep the names of a script after each of its blocks; no text is added to its page."""
    script = Path(block_vars["src_file"]).resolve().relative_to(GALLERY).with_suffix("").as_posix()
    _running[script] = block_vars["example_globals"]
    return ""


def check_truths(gallery_conf: dict[str, Any], file_name: str, when: str) -> None:
    """Check a script's names when it has run.

    Raises
    ------
    AssertionError
        If the script does not find the values that it is known to find.
    """
    if when == "before":
        if "STRUCTID_DATA" not in os.environ and DATA.exists():
            os.environ["STRUCTID_DATA"] = str(DATA)
        return
    script, names = _running.popitem()
    if not HOLDS.get(script, bool)(names):
        raise AssertionError(f"{script}: misses the values that docs/truths.py knows it to find")
