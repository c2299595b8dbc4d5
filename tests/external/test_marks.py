"""Parameters marked by card and field, or keyword and entry: the number is found in every form, the rest of the deck stays."""

from __future__ import annotations

import json

import pytest
from solver_cases import MATRICES_STEP, needs_ccx, own_plate, plate_deck, plate_record, unknown
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.errors import InputError
from structid.external.deck import Deck, DeckParameter
from structid.external.marks import CardField, KeywordEntry, value_at, with_marks

RUN = CliRunner()


def written(texts: dict[str, str], marks: dict, values: dict[str, float]) -> dict[str, str]:
    """The deck with `values`, as the solver is given it."""
    places = [(name, mark.locate(texts)) for name, mark in marks.items()]
    deck = Deck(with_marks(texts, places), [DeckParameter(name, value) for name, value in values.items()])
    return deck.written(values)


SMALL = "$ comment 2.1+11\nMAT1    1       2.1+11          .3      7.8D3   $ steel\nMAT1    2       7.+10           .33     2700.\n"
CONTINUED = (
    "PBEAM   7       1       1.0     2.0     3.0     0.0     4.0     0.0     +\r\n"
    "+       .5      .6      .7\r\n"
    "PBEAM   8       1       1.0     2.0     3.0     0.0     4.0\r\n"
)
LARGE = (
    "MAT1*                  1 2.068427188E+11                      0.3*\n"
    "*              7.8000E+3          1.2E-5\n"
    "*                  20.25\n"
)
FREE = "MAT1, 1, 2.1+11, , 0.3, 7800.\nmat1*,2,6.89475729318+10,,0.33\n*,2700.,,,0.02\nPSHELL,4,1,0.01,1\n"


@pytest.mark.parametrize(
    "text, mark, held, old, new",
    [
        (SMALL, CardField("MAT1", 3, 1), 2.1e11, "1       2.1+11          ", "1       1234.568        "),
        (SMALL, CardField("mat1", 6, "1"), 7800.0, "7.8D3   $", "1234.568$"),
        (SMALL, CardField("MAT1", 6, 2), 2700.0, "2700.\n", "1234.568\n"),
        (CONTINUED, CardField("PBEAM", 13, 7), 0.6, ".6      .7", "1234.568.7"),
        (CONTINUED, CardField("PBEAM", 14, 7), 0.7, ".7\r\n", "1234.568\r\n"),
        (
            CONTINUED,
            CardField("PBEAM", 5, 8),
            2.0,
            "8       1       1.0     2.0     ",
            "8       1       1.0     1234.568",
        ),
        (LARGE, CardField("MAT1", 3), 2.068427188e11, " 2.068427188E+11", "1234.56789012346"),
        (LARGE, CardField("MAT1", 6, 1), 7800.0, "       7.8000E+3", "1234.56789012346"),
        (LARGE, CardField("MAT1", 12, 1), 20.25, "           20.25", "1234.56789012346"),
        (FREE, CardField("MAT1", 3, 1), 2.1e11, " 2.1+11, ,", "1234.568, ,"),
        (FREE, CardField("MAT1", 6, 1), 7800.0, " 7800.\n", "1234.568\n"),
        (FREE, CardField("MAT1", 3, 2), 6.89475729318e10, "6.89475729318+10", "1234.56789012346"),
        (FREE, CardField("MAT1", 6, 2), 2700.0, "2700.,,,0.02", "1234.56789012346,,,0.02"),
        ("PBEAM,7,1,1.,2.,3.,0.,4.,0.,+A\n+A,.5,.6\n,.8\n", CardField("PBEAM", 13), 0.6, ",.6", ",1234.568"),
        ("PBEAM,7,1,1.,2.,3.,0.,4.,0.,+A\n+A,.5,.6\n,.8\n", CardField("PBEAM", 22), 0.8, ",.8", ",1234.568"),
        (FREE, CardField("PSHELL", 4), 0.01, "0.01,1", "1234.568,1"),
    ],
)
def test_a_field_of_a_card_takes_the_number_and_all_else_stays(text, mark, held, old, new):
    assert text.count(old) == 1
    assert mark.locate({"m.bdf": text}).value == held
    given = written({"main.bdf": "SOL 103\n", "m.bdf": text}, {"p": mark}, {"p": 1234.5678901234567})
    got, expected = given["m.bdf"], text.replace(old, new)
    assert [line.rstrip(" ") for line in got.split("\n")] == [line.rstrip(" ") for line in expected.split("\n")]


def test_two_parameters_on_a_line_keep_its_columns_whatever_their_names():
    marks = {"modulus_of_the_web": CardField("MAT1", 3, 1), "rho": CardField("MAT1", 6, 1)}
    given = written({"m.bdf": SMALL}, marks, {"modulus_of_the_web": 1.9e11, "rho": 7850.0})
    assert given["m.bdf"].split("\n")[1] == "MAT1    1       1.9E11          .3      7850.   $ steel"


KEYWORDS = """** *ELASTIC
*MATERIAL, NAME=Steel
*Elastic, type = ISO
** modulus, ratio
 2.1D5 , 0.3
*DENSITY
7.8e-9
*MATERIAL,
 NAME=ALU
*ELASTIC
70000, 0.33
*SHELL SECTION, ELSET=WEB, MATERIAL=ALU
0.5
*SHELL SECTION, ELSET=FLANGE, MATERIAL=ALU
0.7
"""


@pytest.mark.parametrize(
    "mark, held, old, new",
    [
        (KeywordEntry("*ELASTIC", 1, of="*MATERIAL, NAME=STEEL"), 2.1e5, "2.1D5", "0.25"),
        (KeywordEntry("elastic", 2, of="material, name=alu"), 0.33, "0.33", "0.25"),
        (KeywordEntry("*ELASTIC, TYPE=ISO", 2), 0.3, "0.3\n", "0.25\n"),
        (KeywordEntry("*Density", 1), 7.8e-9, "7.8e-9", "0.25"),
        (KeywordEntry("*SHELL SECTION, ELSET=FLANGE", 1), 0.7, "0.7", "0.25"),
    ],
)
def test_an_entry_of_a_keyword_takes_the_number_and_all_else_stays(mark, held, old, new):
    assert mark.locate({"m.inp": KEYWORDS}).value == held
    assert written({"m.inp": KEYWORDS}, {"p": mark}, {"p": 0.25})["m.inp"] == KEYWORDS.replace(old, new)


@pytest.mark.parametrize(
    "text, mark, message",
    [
        (SMALL, CardField("MAT1", 3, 5), r"a: there is no card MAT1 5; there are MAT1 1 \(line 2\), MAT1 2 \(line 3\)"),
        (SMALL, CardField("MAT8", 3, 1), "no card MAT8 1; files that it includes must be listed in `deck`"),
        (SMALL, CardField("MAT1", 3), "MAT1 stands 2 times: a line 2, a line 3; give `id`"),
        (SMALL + SMALL, CardField("MAT1", 3, 2), "MAT1 2 stands 2 times: a line 3, a line 6; leave one"),
        (SMALL, CardField("MAT1", 4, 1), "a, line 2: field 4 of MAT1 1 is blank; write the number"),
        (SMALL, CardField("MAT1", 12, 1), "a, line 2: field 12 of MAT1 1 is not there"),
        (SMALL, CardField("MAT1", 2, 1), "field 2 of MAT1 1 holds the whole number 1"),
        (SMALL, CardField("MAT1", 11, 1), "field 11 of a card holds no number; fields are counted"),
        ("MAT1    1       2.1EE5", CardField("MAT1", 3, 1), "line 1: field 3 of MAT1 1 holds no number, but '2.1EE5'"),
        ("MAT1\t1\t2.1E5   ", CardField("MAT1", 3), "a, line 1: tabs move the columns of this MAT1"),
        ("MAT1    1       {{E:8}}        0.3", CardField("MAT1", 3), r"marks in braces move"),
        ("MAT1,1,{{E}}", CardField("MAT1", 3), r"is marked by \{\{E\}\}; take this out"),
        (KEYWORDS, KeywordEntry("*ELASTIC", 1), "stands 2 times: a line 3, a line 10; say which"),
        (KEYWORDS, KeywordEntry("*ELASTIC", 1, of="*MATERIAL, NAME=LEAD"), "no .*LEAD; ELASTIC stands in a line 3, a line 10"),
        (KEYWORDS, KeywordEntry("*DAMPING", 1), r"no \*DAMPING; files"),
        (KEYWORDS, KeywordEntry("*DENSITY", 1, 2), "a, line 6: .DENSITY has 1 data lines, no line 2"),
        (KEYWORDS, KeywordEntry("*DENSITY", 2), "a, line 7: the data line of .DENSITY has 1 entries, no entry 2"),
        ("*ELASTIC\n, 0.3", KeywordEntry("*ELASTIC", 1), "a, line 2: entry 1 of .ELASTIC is blank"),
        ("*NODE\nSTEEL, 0.3", KeywordEntry("*NODE", 1), "a, line 2: entry 1 of .NODE holds no number, but 'STEEL'"),
    ],
)  # fmt: skip
def test_a_place_that_is_not_there_or_not_the_only_one_is_told_with_file_and_line(text, mark, message):
    with pytest.raises(InputError, match=message):
        mark.locate({"a": text})


def test_one_number_is_one_parameter_and_a_parameter_has_one_value():
    first, second = (CardField("MAT1", 3, k).locate({"a": SMALL}) for k in (1, 2))
    with pytest.raises(InputError, match="a, line 2: 'F' and 'E' are the same number"):
        with_marks({"a": SMALL}, [("F", first), ("E", first)])
    with pytest.raises(InputError, match=r"a, line 3: 'E' is 7e\+10 here and 2\.1e\+11 in a, line 2; give `value`"):
        value_at("E", [first, second])


def marked_study(folder, left: str, right: str = "", deck: str | None = None):
    (folder / "plate.inp").write_text(deck or plate_deck("2.1e11", "7e10", MATRICES_STEP))
    of = 'mark = {{ keyword = "*ELASTIC", of = "*MATERIAL, NAME={}", entry = 1 }}\n'
    sides = {"E_left": left or of.format("LEFT"), "E_right": right or of.format("RIGHT")}
    own = "".join(
        f'[[structure.solver.parameter]]\nname = "{name}"\nunit = "Pa"\n{more}' for name, more in sides.items()
    )
    head = '[structure.solver]\ndeck = "plate.inp"\ncommand = "ccx {stem}"\nstiffness = "{stem}.sti"\nmass = "{stem}.mas"\n'
    record = '[record]\npath = "measured.csv"\n[record.modes]\nfrequency_error = 0.001\nshape_error = 0.01\n'
    path = folder / "study.toml"
    path.write_text(head + own + "".join(map(unknown, sides)) + record)
    return path


@needs_ccx
def test_a_deck_without_braces_is_identified_and_updated_in_its_two_numbers_alone(tmp_path):
    plate_record(own_plate(tmp_path, 1.9e11, 0.77e11), tmp_path / "measured.csv")
    path = marked_study(tmp_path, "")
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "out"), "--no-report"])
    assert done.exit_code == 0, done.stderr
    found = json.loads((tmp_path / "out" / "estimate.json").read_text())["parameters"]
    assert [one["initial"] for one in found] == [2.1e11, 7e10]  # as the deck has it
    assert [one["value"] for one in found] == pytest.approx([1.9e11, 0.77e11], rel=1e-6)
    before, after = (
        (folder / "plate.inp").read_text().splitlines() for folder in (tmp_path, tmp_path / "out" / "updated")
    )
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert [old for old, _ in changed] == ["2.1e11, 0.3", "7e10, 0.3"]
    assert [float(new.split(",")[0]) for _, new in changed] == pytest.approx([one["value"] for one in found], rel=1e-12)


@pytest.mark.parametrize(
    "left, message",
    [
        ('mark = { keyword = "*ELASTIC", entry = 1 }\n', "mark: *ELASTIC stands 2 times: plate.inp line"),
        ('mark = { card = "MAT1", id = 1, field = 3 }\n', "mark: plate.inp: there is no card MAT1 1;"),
        ('mark = { keyword = "*ELASTIC" }\n', "`entry` is missing"),
        ('mark = { card = "MAT1", id = 1, fields = 3 }\n', "unknown key; the nearest is `field`"),
        ('mark = "MAT1"\n', "mark: must be a place such as"),
        ("bounds = [1.0, 2.0]\n", "`value` is missing"),
        (
            'mark = [{ keyword = "*ELASTIC", of = "*MATERIAL, NAME=LEFT", entry = 1 }, { keyword = "*DENSITY",'
            ' of = "*MATERIAL, NAME=LEFT", entry = 1 }]\n',
            "'E_left' is 7800 here and 2.1e+11 in plate.inp",
        ),
    ],
)
def test_a_mark_that_cannot_be_used_ends_with_2_and_its_line_of_the_study(tmp_path, left, message):
    plate_record(own_plate(tmp_path, 1.9e11, 0.77e11), tmp_path / "measured.csv")
    done = RUN.invoke(cli.app, ["check", str(marked_study(tmp_path, left))])
    words = " ".join(done.stderr.split())
    assert done.exit_code == 2, words
    assert message in words, words
    assert "study.toml, line" in words, words
    assert "structure.solver.parameter" in words, words
