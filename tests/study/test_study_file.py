"""The study file: what is wrong in it is told with file, line, section, key and remedy."""

from __future__ import annotations

import copy
import itertools
import json
import re
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import scipy.io
from scipy import sparse

from structid.core.errors import InputError
from structid.fem import ELEMENT_TYPES, Beam, Structure
from structid.inversion import LevenbergMarquardt
from structid.inversion.search.levenberg_marquardt import GaussNewton
from structid.study.json_schema import study_schema
from structid.study.schema.study import load_study
from study_cases import CHAIN, line_of, replaced, write_chain

# what is changed in the study, the new text, where the line is looked for, and what the message must say
WRONG = [
    ('title = "Ch', 'titel = "Ch', "titel", ["top level titel", "unknown key", "`title`"]),
    ("active =", "activ =", "activ", ["[structure] activ", "unknown key", "`active`"]),
    ("mass = 2.4", "mas = 2.4", "mas =", ['[[structure.point_mass]] "mass 1" mas:', "`mass`"]),
    ("mass = 2.4", 'mass = "2.4"', 'mass = "2', ['"mass 1" mass: must be a number', "'2.4'"]),
    ("mass = 2.4", "mass = nan", "mass = nan", ["must be a number", "nan"]),
    ("mass = 2.4", "mass = true", "mass = true", ["must be a number", "True"]),
    ("mass = 2.4", "mass = -2.4", "mass = -2.4", ['"mass 1" mass: must be a number of at least 0', "-2.4"]),
    ("mass = 2.4\n", "", "[[structure.point_mass]]", ["`mass` is missing", "add `mass = ...`"]),
    ("mass = 2.4", "mass = [2.4, 2.4]", "[[structure.point_mass]]", ["must be one number or 1"]),
    ("nodes = 1\n", "nodes = 7\n", "nodes = 7", ["node 7 does not exist; the nearest is 3", "[structure.nodes]"]),
    ("nodes = 1\n", "nodes = [[1, 2], [3]]\n", "nodes = [[1", ["must be node numbers"]),
    ("nodes = 1\n", "nodes = 1.5\n", "nodes = 1.5", ["must be node numbers"]),
    ('first = "1X"', 'first = "1Q"', 'first = "1Q"', ['"ground" first', "'1Q'", "12Z+"]),
    ('first = "1X"', 'first = "9X"', 'first = "9X"', ["node 9 does not exist"]),
    ('second = ["2X", "3X"]', 'second = ["2X"]', '[[structure.spring]]\nname = "upper', ["as many entries as `first`"]),
    (
        'name = "mass 2"',
        'name = "mass 1"',
        "[[structure.point_mass]]",
        ["two parts of the structure are called 'mass 1'"],
    ),
    ("1 = 0.0", "one = 0.0", "one = 0.0", ["[structure.nodes] one", "whole numbers"]),
    ("1 = 0.0", "1 = [0.0, 1.0]", "2 = 1.0", ["[structure.nodes] 2", "2 coordinates"]),
    ("1 = 0.0", "1 = [inf]", "1 = [inf]", ["[structure.nodes] 1", "coordinates"]),
    ("[structure]\n", '[structure]\nfixed = ["4X"]\n', 'fixed = ["4X"]', ["fixed", "node 4 does not exist"]),
    ("[structure]\n", '[structure]\nfixed = ["1", "2", "3"]\n', "[structure]", ["no degree of freedom is free"]),
    ('active = ["X"]', 'active = ["Q"]', "active", ["[structure] active", "X Y Z RX RY RZ"]),
    ("[[structure.spring]]", "[[structure.sprng]]", "[[structure.sprng]]", ["sprng", "the nearest is `spring`"]),
    ("[[structure.point_mass]]", "[[structure.lumped_mass]]", "[[structure.lumped", ["the nearest is `point_mass`;"]),
    ("[[structure.point_mass]]", "[structure.lumped_mass]", "[structure.lumped", ["the nearest is `point_mass`;"]),
    ('active = ["X"]', "lumped_mass = 3.0", "lumped_mass", ["the nearest is `total_mass`;"]),
    ("mass = 2.4", "mane = 2.4", "mane", ["the nearest are `name` and `mass`;"]),
    ("[[structure.dashpot]]", "[structure.dashpot]", "[structure.dashpot]", ["write [[structure.dashpot]]"]),
    ('elements = "mass 2"', 'elements = "mas 2"', "[[unknown]]", ["no element set 'mas 2'", "nearest is 'mass 2'"]),
    ('property = "mass"\nelements = "mass 3"', 'property = "maß"\nelements = "mass 3"', None, ["'maß'", "it has mass"]),
    ("each = true", "each = 0", "each = 0", ['[[unknown]] "stiffness" each', "true or false"]),
    ("each = true", "eech = true", "eech", ["unknown key", "`each`"]),
    ("each = true", "prior = {mean = 1.0, std = 0.0}", "prior", ["[unknown.prior] std", "greater than 0"]),
    ("each = true", "prior = {mean = 1.0, sdt = 1.0}", "prior", ["sdt", "`std`"]),
    ("each = true", "prior = 1.0", "prior", ["must be a table"]),
    ("each = true", "bounds = [2.0, 1.0]", "bounds", ["increasing"]),
    ("each = true", 'tied_to = "stiffness[grond]"', "[[unknown]]", ["nearest is 'stiffness[ground]'"]),
    ("each = true", "start = -5.0", "[[unknown]]", ["initial value of stiffness[upper] must lie between 0"]),
    ('path = "frf.npz"', 'path = "frv.npz"', "path", ["[record] path", "no such file", "did you mean frf.npz?"]),
    ('path = "frf.npz"', "path = 3", "path", ["must be a text in quotes"]),
    ('path = "frf.npz"', "", "[record]", ["needs `path"]),
    ('path = "frf.npz"', 'path = "frf.npz"\nrepeats = ["a", "b"]', "[record]", ["not both"]),
    ('path = "frf.npz"', 'repeats = ["frf.npz"]', "repeats", ["at least 2 files"]),
    ('path = "frf.npz"', 'file = "frf.npz"', "file =", ["[record] file: unknown key; the nearest is `path`;"]),
    ("mass = 2.4", "m = 2.4", "m =", ["unknown key; the nearest is `mass`;"]),
    ('path = "frf.npz"', 'path = "frf.npz"\nkindd = "mobility"', "kindd", ["unknown key", "`kind`"]),
    ('path = "frf.npz"', 'path = "frf.npz"\naverages = 0', "averages", ["at least 1"]),
    ('path = "frf.npz"', 'path = "frf.npz"\nchannels_used = ["1"]', "channels_used", ["degree of freedom"]),
    ("relative = 0.01", "relativ = 0.01", "relativ", ["[record.noise] relativ", "`relative`"]),
    ("relative = 0.01", "relative = -1", "relative", ["at least 0"]),
    (
        "relative = 0.01",
        "relative = 10",
        "relative",
        [
            "[record.noise] relative",
            "at most 1, as in 0.01 for 1 %, got 10; noise above 100 % of each value is given by `abs",
        ],
    ),
    ("relative = 0.01", "relative = 0", "[record.noise]", ["greater than 0", "from_coherence"]),
    ("relative = 0.01", "relative = 0.1\nfrom_coherence = true", "[record.noise]", ["keep one of them"]),
    ("[method]", "[record.frf]\noverlap = 1.5\n[method]", "overlap", ["[record.frf] overlap", "less than 1"]),
    ("band = [0.5, 12.0]", "band = [12.0, 0.5]", "band", ["[method] band", "two increasing numbers"]),
    ("band = [0.5, 12.0]", "band = [-1.0, 5.0]", "band", ["[method] band", "from 0 Hz or more", "got -1 to 5 Hz"]),
    ("band = [0.5, 12.0]", "band = [12.0]", "band", ["two increasing numbers"]),
    ("band = [0.5, 12.0]", 'residual = "logs"', "residual", ['"log"', '"pole_free"']),
    ("band = [0.5, 12.0]", 'search = "newton"', "search", ["levenberg_marquardt", "gauss_newton"]),
    ("band = [0.5, 12.0]", "n_modes = 0", "n_modes", ["at least 1"]),
    ("band = [0.5, 12.0]", "reduced = 1", "reduced", ["[method] reduced", "at least 0 and at most 0.01"]),
    ("band = [0.5, 12.0]", "bend = [0.5, 12.0]", "bend", ["[method] bend", "`band`"]),
    ("[method]\n", "method = 1\n", "method", ["[record.noise] method", "unknown key"]),
]


@pytest.mark.parametrize("old, new, place, words", WRONG, ids=[(new or old)[:40] for old, new, _, _ in WRONG])
def test_what_is_wrong_is_named_with_line_and_remedy(tmp_path, old, new, place, words):
    text = replaced(old, new)
    path = write_chain(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_study(path)
    message = str(caught.value)
    assert message.startswith(f"{path}, line ")
    for word in words:
        assert word in message
    if place is not None and text.count(place) == 1:
        assert message.startswith(f"{path}, line {line_of(place, text)}: ")


def test_the_wrong_one_of_several_unknowns_is_named(tmp_path):
    text = replaced('elements = "mass 2"', 'elements = "mass 1"')
    wrong = [i for i, line in enumerate(text.splitlines(), 1) if line == "[[unknown]]"][1]
    with pytest.raises(InputError, match=f"line {wrong}: .*claim the same value|line {wrong}: .*two parameters"):
        load_study(write_chain(tmp_path, text))


@pytest.mark.parametrize(
    "text, words",
    [
        ("a = \n", ["line 1", "column", "not TOML"]),
        (CHAIN + '[structure]\nactive = ["X"]\n', [f"line {CHAIN.count(chr(10)) + 1}", "not TOML"]),
        (CHAIN + "x = [1,\n", [f"line {CHAIN.count(chr(10)) + 1}", "not TOML"]),
        ('title = "open\n', ["line 1", "correct 'title = \"open'"]),
        ("", ["the file is empty"]),
        ('title = "x"\n', ["line 1", "[structure] is missing"]),
        ("[structure]\n[record]\n", ["line 1", "[structure]: the structure has no nodes"]),
        ("structure = 3\n", ["line 1", "write [structure]"]),
        ("[structure]\nnodes.1 = 0.0\n[record]\n", ["the structure has no elements", "[[structure.spring]]"]),
    ],
)
def test_a_file_that_is_no_study_is_refused(tmp_path, text, words):
    path = write_chain(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_study(path)
    assert str(caught.value).startswith(str(path))
    for word in words:
        assert word in str(caught.value)


def test_a_record_in_the_place_of_a_study_is_told_where_records_are_named(tmp_path):
    (tmp_path / "hammer.csv").write_text("Frequency [Hz],1Y/2Y re\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"hammer.csv: is no study.*`structid init`.*`path` of \[record\]"):
        load_study(tmp_path / "hammer.csv")
    (tmp_path / "study.txt").write_text("[ structure ]\nnodes = \n", encoding="utf-8")  # TOML allows the blanks
    with pytest.raises(InputError, match=r"study.txt, line 2.*: not TOML"):
        load_study(tmp_path / "study.txt")


def test_a_file_of_other_bytes_is_refused_with_its_line(tmp_path):
    path = write_chain(tmp_path)
    path.write_bytes(b'title = "x"\n# \xff\xfe\n')
    with pytest.raises(InputError, match="line 2: the file is not UTF-8"):
        load_study(path)


def test_a_missing_study_suggests_the_nearest_name(tmp_path):
    write_chain(tmp_path)
    with pytest.raises(InputError, match=r"chian\.toml: there is no such file; did you mean chain\.toml"):
        load_study(tmp_path / "chian.toml")


@pytest.mark.parametrize("change", [lambda t: t[: t.index("[[unknown]]")] + t[t.index("[record]") :],
                                    lambda t: t.replace("[[unknown]]", "[[unknown]]\nfixed = true")])  # fmt: skip
def test_a_study_without_a_parameter_is_refused(tmp_path, change):
    with pytest.raises(InputError, match=r"no parameter to identify|none to identify"):
        load_study(write_chain(tmp_path, change(CHAIN)))


def test_a_byte_order_mark_and_windows_line_ends_are_read(tmp_path):
    path = write_chain(tmp_path)
    path.write_bytes(b"\xef\xbb\xbf" + replaced("mass = 2.4", "mas = 2.4").replace("\n", "\r\n").encode())
    with pytest.raises(InputError, match=f"line {line_of('mass = 2.4', CHAIN)}: .*mas: unknown key"):
        load_study(path)


def test_every_method_key_reaches_the_options(tmp_path):
    method = (
        'band = [1, 9.5]\nexclude = [[2.0, 2.5]]\nresidual = "log"\nmodel_error = 0.1\npole_free_start = false\n'
        'search = "gauss_newton"\nmax_iterations = 7\ntotal_mass_direction = "X"\nn_modes = 2\n'
        "restarts = 3\nseed = 4\nevaluation_band = [1, 11]\nreduced = 1e-6"
    )
    options = load_study(write_chain(tmp_path, replaced("band = [0.5, 12.0]", method))).options
    assert (options.band, options.exclude, options.residual) == ((1.0, 9.5), ((2.0, 2.5),), "log")
    assert (options.model_error, options.pole_free_start, options.direction, options.n_modes) == (0.1, False, "X", 2)
    assert (options.restarts, options.seed, options.evaluation_band) == (3, 4, (1.0, 11.0))
    assert options.method == GaussNewton(max_iterations=7)
    assert options.reduced == 1e-6
    assert load_study(write_chain(tmp_path)).options.method == LevenbergMarquardt()


def test_every_unknown_key_reaches_the_parameters(tmp_path):
    extra = "start = 800.0\nbounds = [500.0, 1500.0]\nprior = {mean = 900.0, std = 50.0}\nname = 'both'"
    unknown = load_study(write_chain(tmp_path, replaced("each = true", extra))).parameters
    i = unknown.names.index("stiffness[both]")
    assert (unknown.start[i], unknown.priors.mean[i], unknown.priors.std[i]) == (800.0, 900.0, 50.0)
    assert (unknown.transforms.lower[i], unknown.transforms.upper[i]) == (500.0, 1500.0)
    tied = replaced("each = true", 'tied_to = "stiffness[ground]"\nratio = 0.5')
    assert load_study(write_chain(tmp_path, tied)).parameters.n_params == 6


ALL_TYPES = """
[structure]
active = ["X", "Y", "Z", "RX", "RY", "RZ"]
fixed = ["1", "3 X RZ", "4Y"]
[structure.nodes]
1 = [0.0, 0.0, 0.0]
2 = [1.0, 0.0, 0.0]
3 = [2.0, 0.0, 0.0]
4 = [2.0, 1.0, 0.0]
5 = [2.0, 1.0, 1.0]
[[structure.bar]]
name = "bar"
nodes = [3, 4]
mass = 1.0
axial_stiffness = 5.0
[[structure.space_beam]]
name = "beams"
nodes = [[1, 2], [2, 3]]
mass = [1.0, 2.0]
bending_stiffness_y = 3.0
bending_stiffness_z = 4.0
orientation = [0, 1, 0]
[[structure.dashpot]]
name = "dashpot"
first = "2X"
viscous_damping = 1.0
[[structure.friction]]
name = "friction"
first = "2X"
friction_force = 0.1
measured_by = ["2X"]
smoothing = 3
[[structure.joint]]
name = "joint"
element = "beams:2"
at = "2RZ"
stiffness = 800.0
loss_factor = 0.01
[[structure.membrane]]
name = "skin"
nodes = [2, 3, 4]
mass = 1.0
tension = 5.0
lumped = true
[[structure.plane]]
name = "sheet"
nodes = [[2, 3, 4]]
youngs_modulus = 5.0
density = 1.0
thickness = 0.1
poisson = 0.3
state = "strain"
[[structure.plate]]
name = "plate"
nodes = [[2, 3, 4]]
youngs_modulus = 5.0
density = 1.0
thickness = 0.1
poisson = 0.3
[[structure.shell]]
name = "shell"
nodes = [[2, 3, 4]]
youngs_modulus = 5.0
density = 1.0
thickness = 0.1
poisson = 0.3
linear_strains = 1.0
[[structure.solid]]
name = "solid"
nodes = [[2, 3, 4, 5]]
youngs_modulus = 5.0
density = 1.0
poisson = 0.3
formulation = "full"
[[structure.point_mass]]
name = "mass"
nodes = [4]
mass = 2.0
directions = ["X", "Y"]
[[structure.rotary_inertia]]
name = "inertia"
nodes = 2
rotary_inertia = 0.5
direction = "RX"
[[structure.spring]]
name = "spring"
first = "2RZ"
stiffness = 1.0
[[structure.rigid_link]]
name = "link"
main = 4
dependents = [5]
[[structure.constraint]]
name = "gear"
dependent = "2Z"
depends_on = [["3Z", 2.0], ["3RY", -0.5]]
[[unknown]]
property = "mass"
elements = "beams:2"
[record]
path = "frf.npz"
"""


def test_every_element_type_and_tie_can_be_written(tmp_path):
    study = load_study(write_chain(tmp_path, ALL_TYPES))
    types = {type(element) for element in study.structure.elements}
    assert types == set(ELEMENT_TYPES.values()) - {Beam}
    free = {str(dof) for dof in study.structure.dofs}
    assert free.isdisjoint({"2Z+", "3X+", "3RZ+", "4Y+"})
    assert "3Z+" in free
    fixed = {str(dof) for dof in study.structure.fixed}
    assert {"1X+", "1RZ+", "3X+", "3RZ+", "4Y+"} <= fixed
    assert len(fixed) == 9
    assert [tie.name for tie in study.structure.ties] == ["link", "gear"]


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("main = 4", "main = 8", ['[[structure.rigid_link]] "link" main', "node 8"]),
        ("dependents = [5]", "dependents = [4]", ["rigid link 'link' needs dependent nodes"]),
        ('["3Z", 2.0]', '["8Z", 2.0]', ['"gear" depends_on', "node 8"]),
        ('["3Z", 2.0]', '["3Z"]', ["degrees of freedom with coefficients"]),
        ('direction = "RX"', 'direction = "X"', ['"inertia" direction: must be one of "RX", "RY"', "'X'"]),
        ("orientation = [0, 1, 0]", "orientation = [1, 0, 0]", ['"beams"', "must not run along the beam"]),
        ("orientation = [0, 1, 0]", "orientation = [0, 1]", ["three numbers"]),
        ('dependent = "2Z"', 'dependent = "1Z"', ["is fixed and also depends on others"]),
        ('element = "beams:2"', 'element = "beam:2"', ['[[structure.joint]] "joint": joint', "the nearest is beams"]),
        ('at = "2RZ"', 'at = "8RZ"', ['[[structure.joint]] "joint" at: node 8 does not exist']),
        ('at = "2RZ"', 'at = "2X"', ['[[structure.joint]] "joint": joint', "no stiffness in 2X", "Y Z RY RZ"]),
        ('at = "2RZ"', 'at = "4RZ"', ['"joint": joint', "node 4 is none of beams:2, which runs from 2 to 3"]),
    ],
)
def test_ties_and_orientations_that_cannot_be_are_placed(tmp_path, old, new, words):
    with pytest.raises(InputError) as caught:
        load_study(write_chain(tmp_path, replaced(old, new, ALL_TYPES)))
    for word in words:
        assert word in str(caught.value)


MATRICES = """
[structure]
fixed = ["3X"]
[structure.matrices]
dofs = "dofs.txt"
[[structure.matrix_group]]
name = "frame"
mass = "M.npz"
stiffness = "K.mtx"
loss_factor = 0.02
[[structure.matrix_group]]
name = "dampers"
damping = "C.npy"
[[unknown]]
property = "stiffness"
elements = "frame"
[record]
path = "frf.npz"
"""
MASS, STIFFNESS = np.diag([2.0, 3.0, 1.0]), np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])


@pytest.fixture
def matrices(tmp_path):
    (tmp_path / "dofs.txt").write_text("# rows\n1X, 2X\n3X  # last\n")
    sparse.save_npz(tmp_path / "M.npz", sparse.csc_array(MASS))
    scipy.io.mmwrite(tmp_path / "K.mtx", sparse.coo_array(STIFFNESS))
    np.save(tmp_path / "C.npy", 0.1 * STIFFNESS)
    return tmp_path


def test_matrices_from_files_make_the_structure_and_are_inputs(matrices):
    study = load_study(write_chain(matrices, MATRICES))
    structure: Structure = study.structure
    np.testing.assert_array_equal(structure.matrix("mass").toarray(), MASS[:2, :2])
    np.testing.assert_array_equal(structure.matrix("stiffness").toarray(), STIFFNESS[:2, :2])
    np.testing.assert_allclose(structure.matrix("damping").toarray(), 0.1 * STIFFNESS[:2, :2], rtol=1e-15)
    assert list(study.digests) == ["chain.toml", "dofs.txt", "M.npz", "K.mtx", "C.npy", "frf.npz"]


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda f: (f / "M.npz").write_bytes((f / "M.npz").read_bytes()[:60]), ['"frame" mass', "M.npz", "save_npz"]),
        (lambda f: (f / "K.mtx").write_text("%%MatrixMarket matrix\n"), ["stiffness", "K.mtx", "mmwrite"]),
        (lambda f: np.save(f / "C.npy", np.ones(3)), ['"dampers" damping', "two dimensions"]),
        (lambda f: np.save(f / "C.npy", 1j * np.eye(3)), ['"dampers" damping', "must hold a real matrix", "complex"]),
        (lambda f: np.save(f / "C.npy", np.eye(2)), ['"dampers"', "(3, 3)"]),
        (lambda f: np.save(f / "C.npy", np.triu(np.ones((3, 3)))), ["must be symmetric"]),
        (lambda f: (f / "dofs.txt").write_text("1X 2Q 3X"), ["[structure.matrices] dofs", "'2Q'"]),
        (lambda f: (f / "dofs.txt").unlink(), ["[structure.matrices] dofs", "no such file"]),
        (lambda f: (f / "M.npz").write_bytes(b""), ["M.npz: the file is empty"]),
    ],
)
def test_matrix_files_that_cannot_be_used_are_named(matrices, change, words):
    change(matrices)
    with pytest.raises(InputError) as caught:
        load_study(write_chain(matrices, MATRICES))
    for word in words:
        assert word in str(caught.value)


WRONG_VALUES = [
    True, 0, -1, 2**80, 1e308, 0.5, "", "x", "1X", [], [[]], [1], [1, 2], [1.5, "a"], ["1X", "2X"], [[1, 2], [3, 4]], {},
    {"mean": 1}, [{}], [{"name": "x"}],
]  # fmt: skip


def inline(value: object) -> str:
    """A value as TOML on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {inline(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(inline(entry) for entry in value) + "]"
    return json.dumps(value)


def places(value: object, path: tuple = ()):
    """Every place in nested tables and lists."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in entries:
        yield (*path, key)
        yield from places(inner, (*path, key))


@pytest.mark.parametrize("n_values", [2, pytest.param(len(WRONG_VALUES), marks=pytest.mark.long)])
@pytest.mark.parametrize("text", [CHAIN, ALL_TYPES], ids=["chain", "all types"])
def test_no_wrong_value_anywhere_gives_anything_but_an_input_error_and_the_schema_allows_what_is_read(
    tmp_path, text, n_values
):
    """Every place has some of the values in turn, or all of them."""
    path = write_chain(tmp_path, text)
    whole = tomllib.loads(text)
    validator = jsonschema.Draft202012Validator(study_schema())
    refused = marked = 0
    turn = itertools.cycle(WRONG_VALUES)
    for place in places(whole):
        for value in itertools.islice(turn, n_values):
            changed = copy.deepcopy(whole)
            holder = changed
            for key in place[:-1]:
                holder = holder[key]
            holder[place[-1]] = value
            path.write_text("\n".join(f"{key} = {inline(entry)}" for key, entry in changed.items()))
            fits = validator.is_valid(tomllib.loads(path.read_text()))
            try:
                load_study(path)
            except InputError as error:
                assert str(error).startswith(f"{path}, line ")  # noqa: PT017
                refused += 1
                marked += not fits
            else:
                assert fits, changed
    assert refused > 0.5 * n_values * len(list(places(whole)))
    assert marked > 0.8 * refused


DOCUMENT = Path(__file__).parents[2] / "docs" / "study-file.md"


def test_the_documented_study_is_read(tmp_path):
    whole = DOCUMENT.read_text(encoding="utf-8").split("## A whole one")[1]
    text = whole.split("```toml\n")[1].split("```")[0]
    study = load_study(write_chain(tmp_path, text))
    assert study.title == "Two masses on springs"
    assert study.parameters.names == ("mass[masses:1]", "mass[masses:2]", "stiffness[ground]")


ODD = {
    "null": ('title = "Chain of three masses"', 'title = "a\\u0000b"', "title: must be a text in quotes"),
    "escape": ('name = "mass 1"', 'name = "\\u001b[31m"', "name: must be a text in quotes"),
    "tiny": ("mass = 1.2", "mass = 1e-320", "mass: must be"),
    "huge": ("mass = 1.2", "mass = 99999999999999999999999", "mass: must be"),
    "deep": ("mass = 1.2", "mass = " + "[" * 20000, "so long or so deep"),
    "digits": ("mass = 1.2", "mass = " + "1" * 5000, "so long or so deep"),
    "far": ('first = "1X"', 'first = "99999999999999999999X"', "cannot read '99999999999999999999X'"),
}


@pytest.mark.parametrize("case", ODD)
def test_values_at_the_ends_of_what_can_be_written(tmp_path, case):
    """Each gave a traceback, before the search or behind it."""
    old, new, words = ODD[case]
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        load_study(write_chain(tmp_path, replaced(old, new)))
    assert str(caught.value).startswith(str(tmp_path / "chain.toml"))
