"""Decks with identified numbers in them: only these change, and CalculiX finds the frequencies of the identified model."""

import subprocess

import numpy as np
import pytest
from solver_cases import CCX, needs_ccx, plate_deck

from structid.core.errors import FileError, InputError
from structid.modal.formats.files import read_modes
from structid.prediction.identified_model import element_values, identified_model
from structid.records.formats import write_record
from structid.study.run.exported_deck import export_deck
from structid.study.run.exports import model_modes
from structid.study.schema.study import load_study
from study_cases import chain_record

UNKNOWNS = (("youngs_modulus", "left"), ("youngs_modulus", "right"), ("density", "right"))


def identified(folder, mesh, elements, unknowns, factors):
    """A study on a deck, and what it would be with each unknown a `factor` off: the study, the model, values of elements."""
    write_record(folder / "frf.npz", chain_record())
    tables = "".join(f'[[unknown]]\nproperty = "{name}"\nelements = "{of}"\n' for name, of in unknowns)
    text = f'[structure]\nmesh = {mesh}\n{elements}{tables}[record]\npath = "frf.npz"\n'
    (folder / "study.toml").write_text(text)
    study = load_study(folder / "study.toml")
    start = study.parameters.start
    covariance = np.diag((0.01 * start) ** 2)
    model = identified_model(study.structure, study.parameters, start * factors, covariance)
    return study, model, element_values(model, start, covariance)


def block_study(folder, deck, factors=(0.9, 1.2, 1.1), unknowns=UNKNOWNS):
    (folder / "plate.inp").write_text(deck)
    solids = "".join(
        f'[[structure.solid]]\nname = "{side}"\ngroup = "{side.upper()}"\nyoungs_modulus = {modulus}\ndensity = {density}\n'
        'poisson = 0.3\nloss_factor = 0.01\nformulation = "full"\n'
        for side, modulus, density in (("left", 2.1e11, 7800.0), ("right", 7e10, 2700.0))
    )  # fmt: skip
    support = '[[structure.support]]\ngroup = "CLAMPED"\ndirections = ["X", "Y", "Z"]\n'
    return identified(folder, '"plate.inp"', solids + support, unknowns, np.array(factors))


DECK = plate_deck("2.1e11", "7.E10", "*FREQUENCY\n10\n*NODE FILE\nU")


def test_only_the_identified_numbers_of_an_abaqus_deck_change(tmp_path):
    study, _, values = block_study(tmp_path, DECK.replace("\n", "\r\n"))
    lines = export_deck(study, values, tmp_path / "new.inp")
    assert "plate.inp with 3 numbers changed" in lines[0]
    old, new = (tmp_path / "plate.inp").read_bytes().split(b"\n"), (tmp_path / "new.inp").read_bytes().split(b"\n")
    changed = {a.strip(): b.strip() for a, b in zip(old, new, strict=True) if a != b}
    assert changed == {b"2.1e11, 0.3": b"1.89E11, 0.3", b"7.E10, 0.3": b"8.4E10, 0.3", b"2700.0": b"2970."}


@needs_ccx
def test_calculix_finds_the_frequencies_of_the_identified_model(tmp_path):
    study, model, values = block_study(tmp_path, DECK, (0.91234567891, 1.23456789123, 1.0987654321))
    export_deck(study, values, tmp_path / "new.inp")
    subprocess.run([CCX, "new"], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    found = read_modes(tmp_path / "new.frd").frequency
    np.testing.assert_allclose(found[:10], model_modes(model, 10).frequency, rtol=1e-6)


#: Four shells of two properties on one material, and a mass; mm, N, t.
WING = """\
$ a wing, as the drawing has it
SOL 103
CEND
BEGIN BULK
{more}GRID           1              0.      0.      0.
GRID           2            100.      0.      0.
GRID           3            200.      0.      0.
GRID           4              0.    100.      0.
GRID           5            100.    100.      0.
GRID           6            200.    100.      0.
CQUAD4         1      10       1       2       5       4
CQUAD4         2      20       2       3       6       5
PSHELL        10       1     2.5       1               1
PSHELL,20,{second},4.,{second},,{second}
MAT1*                  1         71000.0         26691.7            0.33
*                2.70E-9                                            0.02
MAT1           2  71000.             .33 2.70E-9
CONM2         77       6          1.5E-4
ENDDATA
"""
SKIN, MASS = ("youngs_modulus", "skin"), ("mass", "conm2")


def wing_study(folder, unknowns, factors, second=2, more=""):
    (folder / "wing.bdf").write_text(WING.format(second=second, more=more))
    shells = "".join(
        f'[[structure.shell]]\nname = "{name}"\ngroup = "{group}"\nyoungs_modulus = 71e9\ndensity = 2700.0\npoisson = 0.33\n'
        f"thickness = {thickness}\nloss_factor = 0.02\nstiffness_damping = 1e5\n"
        for name, group, thickness in (("skin", 10, 2.5e-3), ("strip", 20, 4e-3))
    )
    support = '[[structure.support]]\nx = 0.0\ndirections = ["X", "Y", "Z", "RX", "RY", "RZ"]\n'
    mesh = '{ path = "wing.bdf", length_unit = "mm", take = ["CONM2"] }'
    return identified(folder, mesh, shells + support, unknowns, np.array(factors))


def changes(folder, name="new.bdf"):
    pairs = zip((folder / "wing.bdf").read_text().splitlines(), (folder / name).read_text().splitlines(), strict=True)
    return [b for a, b in pairs if a != b]


def test_numbers_of_a_nastran_deck_change_in_their_fields(tmp_path):
    unknowns = [SKIN, ("density", "skin"), ("loss_factor", "skin"), ("thickness", "strip"), MASS]
    study, _, values = wing_study(tmp_path, unknowns, (0.9, 1.1, 1.5, 1.05, 2.0))
    lines = export_deck(study, values, tmp_path / "new.bdf")
    assert changes(tmp_path) == [
        "PSHELL,20,2,4.2,2,,2",
        "MAT1*                  1          63900.        24022.53            0.33",
        "*                2.97E-9                                            0.03",
        "CONM2         77       6           3.E-4",
    ]
    assert any("MAT1 1, youngs_modulus[skin]: 71000.0 becomes 63900." in line for line in lines)


def test_masses_are_those_before_wtmass(tmp_path):
    study, _, values = wing_study(tmp_path, [MASS], (2.0,), more="PARAM,WTMASS,0.5\n")
    export_deck(study, values, tmp_path / "new.bdf")
    [line] = changes(tmp_path)
    assert float(line.split()[3].replace("E-", "e-")) == pytest.approx(3e-4)


def test_a_number_that_is_not_of_the_identified_alone_is_refused(tmp_path):
    study, _, values = wing_study(tmp_path, [SKIN], (0.9,), second=1)
    with pytest.raises(
        InputError, match=r"MAT1 1 in wing\.bdf is the material of 'skin' and of 'strip', whose youngs_mod"
    ):
        export_deck(study, values, tmp_path / "new.bdf")
    study, _, values = wing_study(tmp_path, [SKIN, ("youngs_modulus", "strip")], (0.9, 0.9), second=1)
    assert "2 numbers" in export_deck(study, values, tmp_path / "new.bdf")[0]  # with the shear modulus
    with pytest.raises(FileError, match=r"must end in \.bdf"):
        export_deck(study, values, tmp_path / "new.inp")


def test_what_is_no_number_of_the_deck_is_said(tmp_path):
    study, _, values = wing_study(tmp_path, [SKIN, ("stiffness_damping", "strip")], (0.9, 1.0))
    assert "not in the deck: stiffness_damping[strip]" in export_deck(study, values, tmp_path / "new.bdf")[0]
    study, _, values = block_study(tmp_path, DECK, (0.9,), [("loss_factor", "left")])
    with pytest.raises(
        InputError, match=r"nothing that was identified \(loss_factor\[left\]\) is a number of plate.inp"
    ):
        export_deck(study, values, tmp_path / "new.inp")
    deck = DECK.replace("2.1e11, 0.3", "2.1e11, 0.3, 20.\n2.0e11, 0.3, 200.")
    study, _, values = block_study(tmp_path, deck)
    with pytest.raises(InputError, match="has more than one number"):
        export_deck(study, values, tmp_path / "new.inp")
