"""Every script of the gallery runs, ends with a picture or words, and finds what it says it finds."""

import os
import re
import runpy
import tempfile
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

GALLERY = Path(__file__).parents[1] / "examples" / "gallery"
SCRIPTS = sorted(path.relative_to(GALLERY).with_suffix("").as_posix() for path in GALLERY.glob("*/*.py"))
SHARED = Path(__file__).parents[2] / "shared" / "data"


def near(found, deviations=4.0, **truth):
    """Whether each parameter is within so many standard deviations of its true value."""
    estimate = getattr(found, "estimate", found)
    names = [name.replace("[", "_").replace("]", "").replace(":", "_").replace(" ", "_") for name in estimate.names]
    at = [names.index(name) for name in truth]
    error = np.abs(estimate.values[at] - list(truth.values()))
    return bool((error <= deviations * estimate.std[at]).all())


#: Of the scripts whose truth is known: what must hold of their names at the end.
HOLDS = {
    "commands/explain": lambda own: near(own["found"], bending_stiffness_beam=30.0, stiffness_support_0RZ=400.0),
    "commands/identify": lambda own: (
        near(own["found"], mass_tip=0.12) and own["found"].estimate["mass[tip]"].std < 1e-3
    ),
    "commands/convert": lambda own: (
        own["record"].values[:, 1].max() == pytest.approx(9.80665 * own["readings"][:, 1].max())
    ),
    "records/frf_cantilever": lambda own: near(own["found"], mass_beam_4=1.2, bending_stiffness_beam_4=8.0),
    "records/histories_output_error": lambda own: near(own["found"], mass_mass_1=1.8, viscous_damping_damper_2=0.8),
    "records/histories_with_leakage": lambda own: (
        near(own["by_spectra"], stiffness_k_1=1000.0, stiffness_k_4=1000.0)
        and own["by_averages"]["viscous_damping[c]"].value > 1.1 * 0.7
        and near(own["by_spectra"], viscous_damping_c=0.7)
    ),
    "records/hammer_with_window": lambda own: near(
        own["found"], mass_mass_1=2.0, stiffness_spring_1=4e4, viscous_damping_damper_2=3.0
    ),
    "records/ambient_modes_to_stiffness": lambda own: (
        near(own["found"], stiffness_storey_1=2.4e6, stiffness_storey_4=1.1e6)
        and own["free"].estimate.status.value == "not_identifiable"
    ),
    "records/ambient_set_ups_merged": lambda own: (
        len(own["modes"].channels) == 8 and own["modes"].mode_shapes.shape[1] == 3
    ),
    "records/free_decay": lambda own: np.abs(own["errors"]).max() < 4,
    "elements/springs_dampers_friction": lambda own: near(own["found"], viscous_damping_oil=6.0),
    "elements/bars_of_a_truss": lambda own: near(own["found"], axial_stiffness_bar_7=3.2e6),
    "elements/beams_in_space": lambda own: near(own["found"], torsional_stiffness_column=2000.0),
    "elements/plate_every_element": lambda own: abs(own["change"].min() - own["soft"].min()) < 0.1,
    "elements/shells_of_a_roof": lambda own: near(own["found"], youngs_modulus_panel=68e9, thickness_panel=4.3e-3),
    "elements/solids": lambda own: near(own["found"], youngs_modulus_block=3.1e9, density_block=1180.0),
    "elements/membrane": lambda own: near(own["found"], mass_head=0.26, tension_head=2600.0),
    "elements/joints": lambda own: near(own["found"], stiffness_bolt=3e4, bending_stiffness_girder=2.1e4),
    "elements/matrices_of_another_code": lambda own: near(own["found"], stiffness_upper=0.9),
    "elements/component": lambda own: (
        near(own["found"], stiffness_mount_1=2e4, stiffness_mount_3=1e4)
        and own["answers"]["reduced"].values == pytest.approx(own["answers"]["whole"].values, rel=1e-4)
        and "changes the model's FRFs" in own["found"].truncations[0].words
    ),
    "elements/timoshenko_and_bernoulli": lambda own: (
        near(own["found"], bending_stiffness_beam=1.1e5, shear_stiffness_beam=1.3e7)
        and own["without"].estimate.chi_square_per_dof > 1e3
    ),
    "elements/solver_in_the_loop": lambda own: "found" not in own or own["found"].estimate.status.value == "converged",
    "records/base_excitation": lambda own: near(own["found"], stiffness_storey_1=5.2e5, viscous_damping_loss_2=700.0),
    "records/table_of_a_laboratory": lambda own: own["modes"].frequency == pytest.approx([6.0], abs=0.01),
    "trust/swapped_cables": lambda own: near(own["found"], stiffness_spring_1=1000.0, stiffness_spring_3=1000.0),
    "trust/wrong_unit": lambda own: near(own["found"], bending_stiffness_beam=80.0, **{"gain_3Y+": 1 / 9.80665}),
    "trust/priors": lambda own: near(own["found"], mass_mass_2=3.0, gain_sensors=1.0),
    "trust/regularization": lambda own: (
        not own["alone"].identified.any() and np.max(own["smooth"].std / own["smooth"].values) < 0.1
    ),
    "trust/bounds": lambda own: [one.side for one in own["found"].estimate.at_bound] == ["lower"],
    "trust/what_varies": lambda own: near(own["found"], bending_stiffness_strip=40.0) and len(own["found"].varied) == 1,
    "trust/several_states": lambda own: list(own["found"].changed) == [True, False, True, False],
    "trust/intervals": lambda own: np.isinf(own["curve"].upper) and own["curve"].lower < 3e4,
    "benchmarks/iasc_asce": lambda own: list(own["found"].changed[:4]) == [True, False, True, False],
    "benchmarks/palisaden": lambda own: own["modes"].frequency == pytest.approx([1.8820, 2.4217, 2.6870], abs=0.01),
    "benchmarks/smu_frame": lambda own: (
        "found" not in own or near(own["found"], 2.0, stiffness_storey_1=7.397 * 4.4482216 / 0.0254)
    ),
    "benchmarks/garteur": lambda own: np.abs(own["after"] / own["measured"] - 1).max() < 0.008,
    "benchmarks/nist_regression": lambda own: own["found"].values == pytest.approx(own["certified"], rel=1e-7),
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_runs_and_holds(name, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    if "STRUCTID_DATA" not in os.environ and SHARED.exists():
        monkeypatch.setenv("STRUCTID_DATA", str(SHARED))
    monkeypatch.chdir((GALLERY / name).parent)
    own = runpy.run_path(str(GALLERY / f"{name}.py"))
    shown = [value for value in own.values() if isinstance(value, Figure)]
    files = [value for value in own.values() if isinstance(value, Path) and value.suffix == ".png"]
    assert shown or files or capsys.readouterr().out
    assert all(file.stat().st_size > 1000 for file in files)
    assert HOLDS.get(name, bool)(own)


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_says_what_one_learns(name):
    text = (GALLERY / f"{name}.py").read_text(encoding="utf-8")
    title, rule, rest = re.match(r'"""\n(.+)\n(=+)\n\n(.*?)"""', text, re.DOTALL).groups()
    assert len(rule) == len(title)
    assert "One learns" in " ".join(rest.split())
    assert len(text.splitlines()) <= 110


def test_there_are_enough_and_every_promise_has_a_script():
    assert len(SCRIPTS) >= 24
    assert set(HOLDS) <= set(SCRIPTS)
