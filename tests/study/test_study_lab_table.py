"""A laboratory's table in a study: the same answer as structid's own table, told by `structid check`, refused with exit 2."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from structid.cli.app import app
from structid.study.schema.records.record import read_histories
from structid.study.schema.study import load_study

EXAMPLE = Path(__file__).parents[2] / "examples" / "first_structure"
RUN = CliRunner()
RECORD = """[record]
path = "lab.csv"
columns = ["Shaker", 3, 4, "Tip"]
channels = ["2Y", "2Y", "3Y", "4Y"]
[record.csv]
skip_rows = 2
footer_rows = 1
"""


@pytest.fixture
def written(tmp_path):
    lines = (EXAMPLE / "record.csv").read_text().splitlines()
    head = ["Measured by N.N.", "Ch;1;2;3;4;5", "Zeit;Shaker;A 1;A 2;Tip;Temp", "s;N;m/s^2;m/s^2;m/s^2;degC"]
    text = "\n".join([*head, *(line + ";21,5" for line in lines[1:]), "Mittel;0;0;0;0;0"]) + "\n"
    (tmp_path / "lab.csv").write_text(text)
    study = (EXAMPLE / "study.toml").read_text()
    before, _, after = study.partition("[record]\n")
    after = after.partition("[record.frf]")[2]
    (tmp_path / "study.toml").write_text(f"{before}{RECORD}[record.frf]{after}")
    return tmp_path / "study.toml"


def test_the_record_is_that_of_the_own_table(written):
    ours, own = (read_histories(load_study(path).setups[0].record)[0] for path in (written, EXAMPLE / "study.toml"))
    np.testing.assert_array_equal(ours.values, own.values)
    assert (ours.channels, ours.quantities, ours.sampling_rate) == (own.channels, own.quantities, own.sampling_rate)


def test_check_says_what_was_understood(written):
    done = RUN.invoke(app, ["check", str(written)])
    text = " ".join(done.stdout.split())
    assert done.exit_code == 0, done.output
    assert "read: lab.csv; 4 columns, 12288 samples at 512 Hz, units N, m/s^2, separated by semicolons" in text
    assert "decimal commas, names in line 3, units in line 4, 1 footer line left out; Shaker is 2Y+" in text


def test_modes_and_convert_say_it_too(written, monkeypatch):
    monkeypatch.chdir(written.parent)
    flags = [
        "--csv-skip-rows",
        "2",
        "--csv-footer-rows",
        "1",
        "--columns",
        "Shaker,3,4,Tip",
        "--channels",
        "2Y,2Y,3Y,4Y",
    ]
    done = RUN.invoke(app, ["convert", "lab.csv", "own.npz", *flags])
    assert (done.exit_code, done.stdout.splitlines()[0][:37]) == (0, "read: lab.csv; 4 columns, 12288 sampl")
    done = RUN.invoke(app, ["modes", "lab.csv", "--method", "ssi_cov", "--no-report", *flags])
    assert "read: 4 columns, 12288 samples at 512 Hz" in done.stdout


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("footer_rows = 1", "footer_rows = 0", "a footer? Leave it out with `footer_rows = 1`"),
        ("skip_rows = 2", "skip_rows = 0", "where line 3 (Zeit, Shaker, A 1, A 2, Tip, Temp) names the columns"),
        ('"Tip"]', "6]", "cannot read 'degC' as the unit of a channel"),
        ("skip_rows = 2", "skip_row = 2", "unknown key; the nearest is `skip_rows`"),
        ('columns = ["Shaker", 3, 4, "Tip"]', 'columns = ["Shaker"]', "`channels` must have 1 entries"),
    ],
)
def test_what_cannot_be_used_exits_2(written, old, new, words):
    written.write_text(written.read_text().replace(old, new))
    done = RUN.invoke(app, ["check", str(written)])
    assert done.exit_code == 2
    assert words in " ".join(done.stderr.split())
    assert "lab.csv" in done.stderr or "[record.csv]" in done.stderr
