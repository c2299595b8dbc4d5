"""Shells in a study file: an angle bracket from an Abaqus mesh, and set-ups with another structure on that mesh."""

import numpy as np
import pytest

from structid import FrfRecord, Structure, parameters, run_study, simulated_record, write_record
from structid.core.errors import InputError
from structid.fem import PointMass
from structid.study.run.check import check_study
from structid.study.schema.study import load_study

STUDY = """title = "Angle bracket of sheet metal, bare and with a mass at its tip"
[structure]
tolerance = 0
mesh = { path = "bracket.inp", length_unit = "mm" }
[structure.points]
9001 = [0.099, 0.061, 0.0]
[[structure.support]]
group = "Clamp"
[[structure.shell]]
name = "web"
group = "Web"
youngs_modulus = 70e9
density = 2700.0
thickness = 2e-3
poisson = 0.3
loss_factor = 0.02
[[structure.shell]]
name = "flange"
group = "Flange"
youngs_modulus = 70e9
density = 2700.0
thickness = 1.5e-3
poisson = 0.3
loss_factor = 0.02
[[unknown]]
property = "youngs_modulus"
elements = ["web", "flange"]
name = "sheet"
start = 72e9
[[unknown]]
property = "thickness"
elements = "flange"
start = 1.6e-3
[[record]]
name = "bare"
path = "bare.npz"
calibration = 0
[[record]]
name = "loaded"
path = "loaded.npz"
calibration = 0
[[record.structure.point_mass]]
name = "known mass"
group = "Tip"
mass = 0.05
"""


def mesh_text():
    """A web in x-y and a flange in x-z, 100 mm long, 60 and 30 mm wide; the last cells of the flange are triangles."""
    x, s = np.linspace(0, 100, 5), [60, 40, 20, 0, 15, 30]
    label = {(i, j): 10 * (i + 1) + j for i in range(5) for j in range(6)}
    nodes = [f"{n}, {x[i]}, {s[j] if j < 3 else 0}, {0 if j < 3 else s[j]}" for (i, j), n in label.items()]
    web, flange = [], []
    for i in range(4):
        for j in range(5):
            a, b, c, d = label[i, j], label[i, j + 1], label[i + 1, j + 1], label[i + 1, j]
            if j < 3:
                web.append(f"{10 * i + j + 1}, {a}, {b}, {c}, {d}")
            else:
                flange += [f"{100 + 10 * i + j}, {a}, {b}, {c}", f"{200 + 10 * i + j}, {a}, {c}, {d}"]
    parts = ["*NODE", *nodes, "*ELEMENT, TYPE=S4R, ELSET=Web", *web, "*ELEMENT, TYPE=S3, ELSET=Flange", *flange]
    clamp = ", ".join(str(label[0, j]) for j in range(6))
    return "\n".join([*parts, "*NSET, NSET=Clamp", clamp, "*NSET, NSET=Tip", str(label[4, 0]), ""])


def folder(tmp_path, text=STUDY):
    """The study with records of the true bracket."""
    (tmp_path / "bracket.inp").write_text(mesh_text())
    (tmp_path / "study.toml").write_text(text)
    frequency = np.linspace(40.0, 700.0, 45)
    for name in ("bare", "loaded"):
        (tmp_path / f"{name}.npz").write_bytes(b"not yet")
    made = load_study(tmp_path / "study.toml").structure
    for name, more in (("bare", []), ("loaded", [PointMass("known mass", [50], 0.05)])):
        structure = Structure(made.nodes, [*made.elements, *more], made.fixed, made.ties)
        like = FrfRecord(frequency, np.ones((45, 3, 1)), ["9001Z", "55Y", "30RX"], ["9001Z"], "accelerance")
        known = parameters(structure, [])
        record = simulated_record(structure, known, like, relative_noise=0.01, rng=np.random.default_rng(len(more)))
        write_record(tmp_path / f"{name}.npz", record)
    return tmp_path / "study.toml"


def test_modulus_and_thickness_of_a_bracket_are_found_from_both_set_ups(tmp_path):
    study = load_study(folder(tmp_path))
    assert check_study(study)
    bare, loaded = (setup.structure for setup in study.setups)
    assert loaded.mass_of() == pytest.approx(bare.mass_of() + 0.05)
    assert bare.mass_of() == pytest.approx(2700 * (0.1 * 0.06 * 2e-3 + 0.1 * 0.03 * 1.5e-3))
    assert {dof.direction for dof in bare.dofs} == {"X", "Y", "Z", "RX", "RY", "RZ"}
    found = run_study(study).identification.estimate
    for name, value in {"youngs_modulus[sheet]": 70e9, "thickness[flange]": 1.5e-3}.items():
        estimated, std = found[name]
        assert abs(estimated - value) <= 4 * std
        assert std <= 0.004 * value


def test_set_ups_may_lack_an_element_set_of_the_mesh_and_be_held_elsewhere(tmp_path):
    text = STUDY.replace('[[record.structure.point_mass]]\nname = "known mass"\ngroup = "Tip"\nmass = 0.05\n', "")
    study = text + '[record.structure]\nwithout = ["flange"]\nfixed = ["10", "11"]\n'
    bare, loaded = (setup.structure for setup in load_study(folder(tmp_path, study)).setups)
    assert [e.name for e in loaded.elements] == ["web"]
    assert {dof.node for dof in loaded.fixed} == {10, 11}
    assert not {dof.node for dof in loaded.dofs} & {14, 15, 24, 25}
    assert loaded.mass_of() < bare.mass_of()


@pytest.mark.parametrize(
    "more, words",
    [
        ('[[record.structure.point_mass]]\nname = "m"\ngroup = "Tap"\nmass = 1.0\n', "there is no group 'Tap' in bracket.inp"),
        ('[[record.structure.point_mass]]\nname = "m"\nnodes = [7]\nmass = 1.0\n', "node 7 does not exist"),
        ('[record.structure]\nwithout = ["flanges"]\n', "measured component 'flanges'; the nearest is 'flange'"),
        ('[record.structure.nodes]\n50 = [0.0, 0.0, 0.0]\n', "node 50 is in [structure.nodes] already"),
    ],
)  # fmt: skip
def test_what_a_set_up_names_wrong_on_a_mesh_is_told(tmp_path, more, words):
    text = STUDY[: STUDY.index("[[record.structure.point_mass]]")] + more
    (tmp_path / "bracket.inp").write_text(mesh_text())
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(InputError) as error:
        load_study(tmp_path / "study.toml")
    assert words in str(error.value)


def test_supports_of_one_set_up_by_group(tmp_path):
    more = '[[record.structure.support]]\ngroup = "Tip"\ndirections = ["Z"]\n[[record.structure.support]]\nx = 0.0\n'
    text = STUDY[: STUDY.index("[[record.structure.point_mass]]")] + more
    bare, loaded = (setup.structure for setup in load_study(folder(tmp_path, text)).setups)
    assert {dof.node for dof in bare.fixed} == set(range(10, 16))
    assert {str(dof) for dof in loaded.fixed if dof.node == 50} == {"50Z+"}
    assert {dof.node for dof in loaded.fixed} == {*range(10, 16), 50}
