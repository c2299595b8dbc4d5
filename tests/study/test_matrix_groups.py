"""Matrices of other codes in a study file: names, numbering, groups of elements, two exports, units, and what is refused."""

import copy
import itertools
import tomllib

import numpy as np
import pytest
from test_study_file import WRONG_VALUES, inline, places

from structid import InputError, Structure
from structid.fem.importers import (
    ElementEntries,
    ImportedMatrix,
    write_abaqus,
    write_dmig,
    write_matrix,
    write_op4,
)
from structid.study.schema.study import load_study
from study_cases import write_chain

MASS = np.diag([2.0, 3.0, 1.0])
FIRST = np.array([[2.0, -1, 0], [-1, 1, 0], [0, 0, 0]])
SECOND = np.array([[0.0, 0, 0], [0, 1, -1], [0, -1, 1]])
DOFS = [[1, 1], [2, 1], [3, 1]]

HEAD = """
[structure]
fixed = ["3X"]
{total}
{matrices}
[[structure.matrix_group]]
name = "frame"
{group}
{second}
[[unknown]]
property = "stiffness"
elements = "frame"
[record]
path = "frf.npz"
"""
BESIDE = '[structure.matrices]\ndofs = "dofs.pch"'


def matrix(name, values, dofs=DOFS):
    return ImportedMatrix(name, values, dofs)


@pytest.fixture
def files(tmp_path):
    """Exports of one chain in the formats of several codes."""
    write_op4(tmp_path / "model.op4", [matrix("MAA", MASS), matrix("KAA", FIRST + SECOND)])
    write_op4(tmp_path / "soft.op4", [matrix("KAA", FIRST + SECOND)])
    write_op4(tmp_path / "stiff.op4", [matrix("KAA", FIRST + 3 * SECOND)])
    write_op4(tmp_path / "cubic.op4", [matrix("KAA", FIRST + 8 * SECOND)])
    write_dmig(tmp_path / "model.pch", [matrix("MAA", MASS), matrix("KAA", FIRST + SECOND)])
    write_dmig(tmp_path / "one.pch", [matrix("K", SECOND[1:, 1:], DOFS[1:])])
    write_dmig(tmp_path / "tonnes.pch", [matrix("MAA", 1e-3 * MASS), matrix("KAA", 1e-3 * (FIRST + SECOND))])
    row, column = (np.repeat([0, 1], 4) + np.tile(at, 2) for at in ([0, 0, 1, 1], [0, 1, 0, 1]))
    entries = ElementEntries(np.repeat([7, 8], 4), row, column, np.tile([1.0, -1.0, -1.0, 1.0], 2))
    springs = np.zeros((3, 3))
    np.add.at(springs, (row, column), entries.value)
    write_abaqus(tmp_path / "job_STIF1.mtx", ImportedMatrix("K", springs, DOFS, elements=entries), "elements")
    write_matrix(tmp_path / "lower.npz", matrix("K", np.tril(FIRST + SECOND)))
    write_op4(tmp_path / "complex.op4", [matrix("KAA", (1 + 0.1j) * (FIRST + SECOND))])
    write_op4(tmp_path / "indefinite.op4", [matrix("KAA", FIRST + SECOND - 3 * np.diag([0, 0, 1.0]))])
    (tmp_path / "dofs.pch").write_text("ASET1          1       1    THRU       3\n")
    return tmp_path


def study(files, group, matrices=BESIDE, total="", second=""):
    return load_study(write_chain(files, HEAD.format(group=group, matrices=matrices, total=total, second=second)))


def matrices_of(structure: Structure):
    return structure.matrix("mass").toarray(), structure.matrix("stiffness").toarray()


@pytest.mark.parametrize(
    "group, beside",
    [
        ('mass = { path = "model.op4", matrix = "MAA" }\nstiffness = { path = "model.op4", matrix = "kaa" }', BESIDE),
        ('mass = { path = "model.pch", matrix = "MAA" }\nstiffness = { path = "model.pch", matrix = "KAA" }', ""),
        ('mass = { path = "model.pch", matrix = "MAA" }\nstiffness = { path = "lower.npz", one_triangle = true }', BESIDE),
        ('mass = { path = "tonnes.pch", matrix = "MAA" }\nstiffness = { path = "tonnes.pch", matrix = "KAA" }',
         '[structure.matrices]\nlength_unit = "mm"\nforce_unit = "N"'),
    ],
)  # fmt: skip
def test_matrices_of_other_codes_make_the_structure(files, group, beside):
    read = study(files, group, beside, "total_mass = 6.0")
    mass, stiffness = matrices_of(read.structure)
    np.testing.assert_allclose(mass, MASS[:2, :2], rtol=1e-14)
    np.testing.assert_allclose(stiffness, (FIRST + SECOND)[:2, :2], rtol=1e-14)


def test_several_files_are_summed_and_groups_of_elements_taken_apart(files):
    group = 'mass = { path = "model.pch", matrix = "MAA" }\nstiffness = ["job_STIF1.mtx", "one.pch"]'
    read = study(files, group, "")
    spring = np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]])
    np.testing.assert_array_equal(matrices_of(read.structure)[1], (spring + 2 * SECOND)[:2, :2])
    assert [name for name in read.digests if name.endswith("mtx")] == ["job_STIF1.mtx"]
    group = 'mass = { path = "model.pch", matrix = "MAA" }\nstiffness = { path = "job_STIF1.mtx", elements = "7-7" }'
    second = '[[structure.matrix_group]]\nname = "rest"\nstiffness = { path = "job_STIF1.mtx", elements = [8] }'
    read = study(files, group, "", second=second)
    values = read.structure.values.copy()
    np.testing.assert_array_equal(matrices_of(read.structure)[1], (spring + SECOND)[:2, :2])
    values[[p.values.start for p in read.structure.properties if p.label == "stiffness[rest]"]] = 0.0
    np.testing.assert_array_equal(read.structure.matrix("stiffness", values).toarray(), spring[:2, :2])


def test_degrees_of_freedom_that_a_file_holds_are_fixed_though_they_have_mass(files):
    (files / "job_STIF2.mtx").write_text("1,1, 1,1, 2.0\n2,1, 1,1, -1.0\n2,1, 2,1, 2.0\n3,1, 3,1, 1.0e36\n")
    group = 'mass = { path = "model.pch", matrix = "MAA" }\nstiffness = "job_STIF2.mtx"'
    text = HEAD.format(group=group, matrices="", total="total_mass = 6.0", second="").replace('fixed = ["3X"]', "")
    structure = load_study(write_chain(files, text)).structure
    assert [str(dof) for dof in structure.fixed] == ["3X+"]
    np.testing.assert_array_equal(matrices_of(structure)[0], MASS[:2, :2])


def test_two_exports_make_a_group(files):
    group = 'mass = { path = "model.op4", matrix = "MAA" }\nstiffness = "soft.op4"'
    second = '[[structure.matrix_group]]\nname = "upper"\nstiffness = { base = "soft.op4", changed = "stiff.op4", factor = 3.0 }'
    read = study(files, group, second=second)
    upper = next(
        part for part in read.structure.contributions if part.matrix_kind == "stiffness" and part.value.start > 1
    )
    np.testing.assert_allclose(upper.blocks.assemble(np.ones(1)).toarray(), SECOND[:2, :2], atol=1e-15)


@pytest.mark.parametrize(
    "group, words",
    [
        ('stiffness = "model.op4"', ['"frame" stiffness', "holds 2 matrices (MAA, KAA)", 'matrix = "MAA"']),
        ('stiffness = { path = "model.op4", matrix = "KXX" }', ["no matrix 'KXX'", "MAA, KAA"]),
        ('stiffness = { path = "none.op4" }', ["no such file"]),
        ('stiffness = { matrix = "KAA" }', ["`path` is missing"]),
        ('stiffness = { path = "soft.op4", matrx = "KAA" }', ["unknown key", "`matrix`"]),
        ('stiffness = []', ["stiffness: must be a file"]),
        ('stiffness = { path = "soft.op4", elements = "1-2" }', ["assembled", "element by element"]),
        ('stiffness = { path = "job_STIF1.mtx", elements = "8-9" }', ["no element 9"]),
        ('stiffness = { path = "job_STIF1.mtx", elements = "9-8" }', ["lower to the higher"]),
        ('stiffness = { path = "job_STIF1.mtx", elements = "a" }', ["must be element labels"]),
        ('stiffness = { path = "soft.op4", one_triangle = true }', ["both sides"]),
        ('stiffness = "complex.op4"', ["must hold a real matrix", "loss_factor"]),
        ('stiffness = "indefinite.op4"', ["positive semidefinite", "3X", "indefinite = true"]),
        ('stiffness = { base = "soft.op4", changed = "stiff.op4" }', ["`factor` is missing"]),
        ('stiffness = { base = "soft.op4", changed = "stiff.op4", factor = 1.0 }', ["not 1"]),
        ('stiffness = { base = "soft.op4", changed = "cubic.op4", factor = 2.0, third = "stiff.op4", third_factor = 1.4422495703 }',
         ["power 3"]),
        ('stiffness = { base = "soft.op4", changed = "one.pch", factor = 2.0 }', ["numbering of `base`"]),
    ],
)  # fmt: skip
def test_matrix_groups_that_cannot_be_used_are_placed(files, group, words):
    with pytest.raises(InputError) as caught:
        study(files, group)
    for word in ["chain.toml, line", *words]:
        assert word in str(caught.value)


def test_indefinite_matrices_pass_where_they_are_meant(files):
    read = study(
        files, 'stiffness = "indefinite.op4"\nindefinite = true\nmass = { path = "model.op4", matrix = "MAA" }'
    )
    assert read.structure.n_dofs == 2


def test_rows_without_numbering_ask_for_it(files):
    with pytest.raises(InputError, match=r'add \[structure.matrices\] with `dofs = "dofs.txt"`'):
        study(files, 'stiffness = "soft.op4"', "")


@pytest.mark.parametrize(
    "total, words", [("total_mass = 6000.0", ["tonnes", "0.001"]), ("total_mass = 12.0", ["half"])]
)
def test_total_mass_of_a_study_checks_the_units(files, total, words):
    group = 'mass = { path = "model.op4", matrix = "MAA" }\nstiffness = "soft.op4"'
    with pytest.raises(InputError) as caught:
        study(files, group, total=total)
    for word in ["[structure] total_mass", "6 kg", *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize("n_values", [2, pytest.param(len(WRONG_VALUES), marks=pytest.mark.long)])
def test_no_wrong_value_anywhere_gives_anything_but_an_input_error(files, n_values):
    """Every place has some of the values in turn, or all of them."""
    group = (
        'mass = { path = "model.op4", matrix = "MAA", one_triangle = false }\n'
        'stiffness = { path = "job_STIF1.mtx", elements = "7-8" }\n'
        'damping = { base = "soft.op4", changed = "stiff.op4", factor = 3.0 }\nindefinite = true'
    )
    beside = BESIDE + '\nlength_unit = "m"\nforce_unit = "N"'
    path = write_chain(files, HEAD.format(group=group, matrices=beside, total="total_mass = 6.0", second=""))
    whole = tomllib.loads(path.read_text())
    refused, turn = 0, itertools.cycle(WRONG_VALUES)
    for place in places(whole["structure"]):
        for value in itertools.islice(turn, n_values):
            changed = copy.deepcopy(whole)
            holder = changed["structure"]
            for key in place[:-1]:
                holder = holder[key]
            holder[place[-1]] = value
            path.write_text("\n".join(f"{key} = {inline(entry)}" for key, entry in changed.items()))
            try:
                load_study(path)
            except InputError:
                refused += 1
    assert refused > 10 * n_values
