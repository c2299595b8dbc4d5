"""A structure on a mesh in a study file: groups, supports, points, what is refused, and the example's numbers."""

import shutil
from pathlib import Path

import pytest

from structid import run_study
from structid.core.errors import InputError
from structid.study.run.check import check_study
from structid.study.schema.study import load_study

EXAMPLE = Path(__file__).parents[2] / "examples" / "plate_from_mesh"
TRUTH = {"youngs_modulus[aluminium]": 68e9, "thickness[strip]": 4.2e-3, "loss_factor[aluminium]": 0.03}


def changed(tmp_path, *swaps):
    """The example's study in a folder of its own, with changes."""
    for name in ("plate.msh", "frf.npz"):
        shutil.copy(EXAMPLE / name, tmp_path / name)
    text = (EXAMPLE / "study.toml").read_text()
    for old, new in swaps:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "study.toml"
    path.write_text(text)
    return path


def test_the_plate_of_the_example_is_found():
    """The simulated model is exact: deviations are those of the noise."""
    found = run_study(load_study(EXAMPLE / "study.toml")).identification.estimate
    for name, value in TRUTH.items():
        estimated, std = found[name].value, found.std_noise[found.names.index(name)]
        assert abs(estimated - value) <= 4 * std
        assert std <= 0.002 * value
    assert found.covariance_basis == "noise"
    assert found["thickness[strip]"][0] == pytest.approx(4.2e-3, rel=5e-4)


def test_the_files_of_the_example_are_those_that_its_script_makes():
    import runpy

    made = runpy.run_path(str(EXAMPLE / "make_files.py"))
    assert made["mesh_text"]() == (EXAMPLE / "plate.msh").read_text()
    structure, study = made["true_structure"](), load_study(EXAMPLE / "study.toml")
    assert [str(d) for d in structure.dofs] == [str(d) for d in study.structure.dofs]


def test_groups_supports_and_points_make_the_structure(tmp_path):
    study = load_study(changed(tmp_path))
    structure = study.structure
    skin, strip = structure.elements
    assert (len(skin.nodes), len(strip.nodes)) == (42, 12)
    assert structure.nodes[63] == pytest.approx([0.4, 0.3, 0.0])
    held = {d.node for d in structure.fixed}
    assert held == set(range(1, 8))
    assert all(structure.nodes[node][0] == 0.0 for node in held)
    point = next(tie for tie in structure.ties if tie.label == 9002)
    assert (point.node, point.distance) == (62, 0.0)
    checked = check_study(study)
    assert checked.channels[0].seen == "+44Z (nearest node, 0.00152 m away)"
    area = 0.4 * 0.3
    assert structure.mass_of(direction="Z") == pytest.approx(2700 * area * (0.003 + 0.25 * 0.001), rel=0.02)


def test_supports_by_coordinates_and_by_nodes_are_those_of_the_group(tmp_path):
    wanted = [str(d) for d in load_study(changed(tmp_path)).structure.dofs]
    for other in ("x = 0.0", "x = [-0.01, 0.001]\ny = [0.0, 0.3]", "nodes = [1, 2, 3, 4, 5, 6, 7]"):
        found = load_study(changed(tmp_path, ('group = "clamp"', other))).structure.dofs
        assert [str(d) for d in found] == wanted


def test_nodes_beside_the_mesh_carry_springs_and_masses(tmp_path):
    more = """[structure.nodes]
8001 = [0.4, 0.25, -0.1]
[[structure.spring]]
name = "hanger"
first = "62Z"
second = "8001Z"
stiffness = 10.0
[[structure.point_mass]]
name = "corner"
nodes = [63]
mass = 0.1
[[structure.support]]
nodes = [8001]
[[structure.support]]"""
    bare = load_study(changed(tmp_path)).structure
    structure = load_study(changed(tmp_path, ("[[structure.support]]", more))).structure
    assert structure.n_dofs == bare.n_dofs
    assert structure.mass_of(direction="Z") == pytest.approx(bare.mass_of(direction="Z") + 0.1)


def test_a_field_is_declared_by_its_grid(tmp_path):
    grid = 'elements = "strip"\nfield = { intervals = [1, 2], degree = 1 }'
    study = load_study(changed(tmp_path, ('elements = "strip"', grid)))
    names = [name for name in study.parameters.names if name.startswith("thickness")]
    assert len(names) == 6
    assert names[0] == "thickness[strip:field 1,1]"


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('path = "plate.msh"', 'path = "plates.msh"', "there is no such file"),
        (
            'length_unit = "mm"',
            'length_unit = "yd"',
            '[structure.mesh] length_unit: must be one of "m", "km", "dm", "cm", "mm"',
        ),
        ('length_unit = "mm"', 'length_unit = "um"', "farther than the cells there are long"),
        (
            "9004 = [0.25, 0.15]",
            "9004 = [0.25, 0.45]",
            "[structure.points] 9004: point 9004 is 0.15 m from the nearest",
        ),
        ("9004 = [0.25, 0.15]", "44 = [0.25, 0.15]", "point 44 is a node of plate.msh already"),
        ('group = "clamp"', 'group = "clam"', "there is no group 'clam' in plate.msh; the nearest is 'clamp'"),
        ('group = "clamp"', "z = 0.5", "no node is at this place"),
        ('group = "clamp"\n', "", "names no nodes; add `group`, `nodes`, or a coordinate"),
        (
            'group = "strip"',
            'group = "stripe"',
            "there is no group of cells 'stripe' in plate.msh; the nearest is 'strip'",
        ),
        ('group = "strip"', 'group = "skin"', "12 cells (quad), in group strip of plate.msh, belong to no element set"),
        ('group = "strip"', 'group = "strip"\nnodes = [[1, 2, 3]]', "needs a mesh, and no `nodes`"),
        ('group = "strip"', 'group = "clamp"', "element 1 of 'strip' has 2 nodes; it can have 3 (triangle), 4 (quad)"),
        ('mesh = { path = "plate.msh", length_unit = "mm" }', "", "the structure has no nodes; add [structure.nodes]"),
        ("[structure.points]", "[structure.nodes]", "must have 3 coordinates like the mesh, got 2"),
        ("thickness = 4e-3", "thickness = 0", "`thickness` of 'strip' must be greater than 0"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path, old, new, words):
    path = changed(tmp_path, (old, new))
    with pytest.raises(InputError) as error:
        load_study(path)
    assert words in str(error.value)
    assert str(path.parent) in str(error.value)


def test_groups_may_be_left_out(tmp_path):
    mesh = 'mesh = { path = "plate.msh", length_unit = "mm", leave_out = "strip" }'
    text = changed(tmp_path, ('mesh = { path = "plate.msh", length_unit = "mm" }', mesh)).read_text()
    first, _, rest = text.partition('[[structure.plate]]\nname = "strip"')
    rest = rest[rest.index("[[unknown]]") :].replace('["skin", "strip"]', '["skin"]').replace('"strip"', '"skin"')
    points = first.replace("9004 = [0.25, 0.15]", "9004 = [0.15, 0.15]").replace(
        "9001 = [0.30, 0.05]", "9001 = [0.35, 0.05]"
    )
    path = tmp_path / "study.toml"
    path.write_text(points + rest)
    assert [len(element.nodes) for element in load_study(path).structure.elements] == [42]


def test_mesh_faults_are_repaired_where_asked(tmp_path):
    path = changed(tmp_path)
    mesh = tmp_path / "plate.msh"
    text = mesh.read_text().replace("$Nodes\n63", "$Nodes\n64").replace("$EndNodes", "900 9 9 9\n$EndNodes")
    mesh.write_text(text)
    with pytest.raises(
        InputError, match=r'line 5: .* node 900 of plate.msh belongs to no cell; .* `orphan_nodes` to "drop"'
    ):
        load_study(path)
    path.write_text(path.read_text().replace('"mm" }', '"mm", orphan_nodes = "drop" }'))
    assert 900 not in load_study(path).structure.nodes


@pytest.mark.parametrize(
    "value", ["5", '""', "true", "[]", "[1, 2, 3]", '["a"]', "{}", "-1.0", '"nothing"', "[[1, 2]]", "1e99"]
)
def test_no_wrong_value_gives_anything_but_an_input_error(tmp_path, value):
    path = changed(tmp_path)
    text, refused = path.read_text(), 0
    for line in text.split("[[unknown]]")[0].splitlines():
        key, mark, _ = line.partition(" = ")
        if mark and not line.startswith("#"):
            path.write_text(text.replace(line, f"{key} = {value}", 1))
            try:
                load_study(path)
            except InputError:
                refused += 1
    assert refused >= 12
