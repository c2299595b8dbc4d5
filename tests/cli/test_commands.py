"""The command line: what it prints, writes and returns."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import structid
from structid.cli import app as cli
from structid.core.errors import SingularModelError
from structid.records.formats import read_record, write_record
from study_cases import (
    CHAIN,
    RIGID,
    TRUE,
    bare,
    chain_record,
    complaints,
    free_text,
    record_from_zero,
    replaced,
    rigid_record,
    with_nan,
    write_chain,
)

RUN = CliRunner()
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


@pytest.fixture
def study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_chain(tmp_path / "study")


def invoke(*arguments: object):
    return RUN.invoke(cli.app, [str(argument) for argument in arguments])


def command(*arguments: object, **options) -> subprocess.CompletedProcess:
    words = [sys.executable, "-m", "structid", *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, env=ENVIRONMENT, timeout=600, check=False, **options)


@pytest.mark.parametrize("name", ["identify", "plan", "compare", "modes", "motion", "correlate"])
def test_a_file_in_the_way_of_the_results_is_told_before_anything_is_read(name, tmp_path):
    (tmp_path / "taken").write_text("mine", encoding="utf-8")
    done = invoke(name, *[tmp_path / "missing.toml"] * (2 if name == "compare" else 1), "--out", tmp_path / "taken")
    assert done.exit_code == 2
    assert f"{tmp_path / 'taken'}: is a file; give another folder" in done.stderr


def test_identify_prints_a_summary_and_writes_the_folder(study, tmp_path):
    done = invoke("identify", study, "--no-report")
    assert (done.exit_code, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0].startswith("Sound: the model explains the record")
    assert lines[1].split() == ["parameter", "value", "unit", "95", "%", "interval", "state"]
    assert lines[-2:] == [
        "Next: Use the values with their intervals.",
        str(Path("chain_results") / "estimate.json"),
    ]
    assert len(lines) == 4 + 8
    row = next(line for line in lines if line.startswith("stiffness[ground]")).split()
    assert row[4:5] + row[-1:] == ["kN/m", "determined"]
    assert 1000 * float(row[1]) == pytest.approx(TRUE["stiffness[ground]"], rel=0.01)
    assert sorted(path.name for path in (tmp_path / "chain_results").iterdir()) == [
        "estimate.h5", "estimate.json", "study.toml", "study_path.txt"
    ]  # fmt: skip


def test_verbose_adds_statistics_initial_values_and_modes(study):
    done = invoke("identify", study, "--no-report", "--verbose")
    assert done.exit_code == 0
    assert "Rank: 8 of 8 parameters" in done.stdout
    assert "Total mass: 6.0" in done.stdout
    assert ["mode", "frequency", "Hz", "damping", "ratio"] in [line.split() for line in done.stdout.splitlines()]
    rows = [line.split() for line in done.stdout.splitlines() if line.startswith("stiffness[ground]")]
    assert rows[1][1:3] == ["kN/m", "1.2000"]


def test_identify_writes_the_report_last(study, tmp_path):
    done = command("identify", study, "--out", tmp_path / "deep" / "out", cwd=tmp_path)
    assert (done.returncode, complaints(done.stderr)) == (0, [])
    assert done.stdout.splitlines()[-1] == str(tmp_path / "deep" / "out" / "report.html")
    names = {path.name for path in (tmp_path / "deep" / "out").iterdir()}
    assert {"estimate.json", "estimate.h5", "study.toml", "report.html"} <= names
    assert list((tmp_path / "deep").glob(".*")) == []
    page = (tmp_path / "deep" / "out" / "report.html").read_text(encoding="utf-8")
    assert "Chain of three masses" in page
    assert str(tmp_path) not in page


@pytest.mark.parametrize("command_name", ["explain", "identify"])
@pytest.mark.parametrize("limit", ["0", "-1", "nan"])
def test_a_time_in_which_no_search_ends_is_refused(study, command_name, limit):
    done = invoke(command_name, study, "--seconds", limit)
    assert done.exit_code == 2
    assert done.stderr.startswith(f"error: --seconds must be greater than 0, got {float(limit):g}; leave it out, or")


def test_times_between_checkpoints_are_not_negative(study):
    done = invoke("identify", study, "--checkpoint", "-1")
    assert (done.exit_code, done.stderr) == (
        2, "error: --checkpoint must be at least 0, got -1; 0 writes every checkpoint\n"
    )  # fmt: skip


def test_check_prints_the_prediction_and_writes_nothing(study, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    done = invoke("check", study)
    assert (done.exit_code, done.stderr) == (0, "")
    assert "rank 8 of 8 parameters" in done.stdout
    assert "accelerance in (m/s^2)/N, 230 of 230 lines" in done.stdout
    assert sorted(tmp_path.rglob("*")) == before


def test_data_that_do_not_determine_the_answer_exit_1_with_results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_chain(tmp_path, RIGID, rigid_record())
    done = invoke("identify", path, "--no-report")
    assert done.exit_code == 1
    assert "error: the data do not determine every parameter" in done.stderr
    assert "- The data determine mass[mass 2] and mass[mass 3] only as a sum" in " ".join(done.stdout.split())
    summary = json.loads((tmp_path / "chain_results" / "estimate.json").read_text())
    assert summary["status"] == "not_identifiable"
    assert summary["rank"] == summary["n_parameters"] - 1
    assert [d["words"] for d in summary["unidentifiable_directions"]] == ["mass[mass 2] and mass[mass 3] only as a sum"]
    lost = {entry["name"]: entry["std"] for entry in summary["parameters"] if not entry["identified"]}
    assert lost == {"mass[mass 2]": None, "mass[mass 3]": None}
    checked = invoke("check", path)
    assert checked.exit_code == 1
    assert "predicted" in checked.stderr


def test_a_search_that_ends_early_exits_1_with_results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = replaced("[method]", "[method]\nmax_iterations = 1\npole_free_start = false")
    done = invoke("identify", write_chain(tmp_path, text), "--no-report")
    assert done.exit_code == 1
    assert "did not converge" in done.stderr
    assert json.loads((tmp_path / "chain_results" / "estimate.json").read_text())["status"] == "not_converged"


def test_a_search_that_cannot_go_on_exits_1(study, monkeypatch):
    def failing(*_arguments):
        raise SingularModelError("the dynamic stiffness is singular at 3 Hz")

    monkeypatch.setattr("structid.study.run.run.identify_together", failing)
    done = invoke("identify", study)
    assert done.exit_code == 1
    assert "the search failed: the dynamic stiffness is singular at 3 Hz" in done.stderr
    assert not Path("chain_results").exists()


def without_unknowns(_folder: Path) -> str:
    return CHAIN[: CHAIN.index("[[unknown]]")] + CHAIN[CHAIN.index("[record]") :]


def cut(folder: Path, suffix: str, keep: int) -> str:
    write_record(folder / f"cut{suffix}", chain_record())
    path = folder / f"cut{suffix}"
    path.write_bytes(path.read_bytes()[:keep])
    return replaced('"frf.npz"', f'"{path.name}"')


def decreasing(folder: Path) -> str:
    return bare(folder, f=chain_record().frequency[::-1])


def at_0_hz(folder: Path) -> str:
    write_record(folder / "zero.npz", record_from_zero())
    text = free_text().replace("[0.5, 12.0]", "[0.0, 12.0]").replace("relative = 0.01", "absolute = 1.0")
    return text.replace("frf.npz", "zero.npz")


UNUSABLE = {
    "NaN": (lambda f: bare(f, h=with_nan(chain_record().values[:, :, 0])), ["bare.npz", "NaN", "remove"]),
    "node": (lambda f: bare(f).replace('["1X", "3X"]', '["1X", "33X"]'), ["node 33", "does not have (nearest: 3)"]),
    "axis": (decreasing, ["bare.npz", "must increase", "sort the lines"]),
    "doubled": (lambda f: bare(f).replace('["1X", "3X"]', '["3X", "3X"]'), ["3X+ twice", "average repeated"]),
    "cut UFF": (lambda f: cut(f, ".uff", 3000), ["cut.uff", "[record] path"]),
    "cut HDF5": (lambda f: cut(f, ".h5", 5000), ["cut.h5", "[record] path"]),
    "empty": (lambda f: cut(f, ".csv", 0), ["cut.csv", "empty", "write or copy it again"]),
    "nothing unknown": (without_unknowns, ["no parameter to identify", "[[unknown]]"]),
    "no supports": (at_0_hz, ["singular at 0 Hz", "add supports", "[structure]"]),
    "unknown key": (lambda f: replaced("active", "activ"), ["activ", "`active`"]),
    "missing file": (lambda f: replaced("frf.npz", "frv.npz"), ["no such file", "frf.npz"]),
    "not TOML": (lambda f: CHAIN + "= 3", ["not TOML"]),
}


@pytest.mark.parametrize("name", ["identify", "check"])
@pytest.mark.parametrize("case", UNUSABLE)
def test_unusable_input_exits_2_and_writes_nothing(tmp_path, monkeypatch, name, case):
    monkeypatch.chdir(tmp_path)
    make, words = UNUSABLE[case]
    path = write_chain(tmp_path, make(tmp_path))
    before = sorted(tmp_path.rglob("*"))
    done = invoke(name, path)
    assert done.exit_code == 2
    assert done.stdout == ""
    assert done.stderr.startswith(f"error: {path}, line ")
    for word in words:
        assert word in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


def test_units_off_by_a_power_of_ten_are_the_first_warning(tmp_path):
    done = invoke("check", write_chain(tmp_path, record=chain_record(scale=1e3)))
    assert done.stdout.splitlines()[1].startswith("warning: the measured accelerance is 1.24e+03 times")
    assert "record and model are in different units" in " ".join(done.stdout.split())


def test_a_wrong_sign_is_a_warning_of_the_results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = invoke("identify", write_chain(tmp_path, record=chain_record(scale=-1.0)), "--no-report", "--no-explain")
    assert "- Driving point 3X+ / 3X+: the real part of mobility is negative" in done.stdout
    warnings = json.loads((tmp_path / "chain_results" / "estimate.json").read_text())["warnings"]
    assert any("driving point" in warning for warning in warnings)


def limited() -> None:
    """No file may grow beyond 20 kB: estimate.json fits, estimate.h5 does not."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


def test_a_write_that_fails_midway_exits_2_and_leaves_nothing(study, tmp_path):
    done = command("identify", study, "--no-report", cwd=tmp_path, preexec_fn=limited)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: chain_results: the results cannot be written (File too large)")
    assert "--out" in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study"]


def test_a_file_where_the_folder_should_be_exits_2(study, tmp_path):
    (tmp_path / "taken").write_text("mine")
    done = invoke("identify", study, "--no-report", "--out", "taken")
    assert done.exit_code == 2
    assert "taken: is a file" in done.stderr
    assert (tmp_path / "taken").read_text() == "mine"


@pytest.mark.parametrize("command_name, summary", [("identify", "estimate"), ("plan", "plan"), ("motion", "motion")])
def test_a_study_of_the_user_is_not_replaced_by_the_copy_of_another(study, tmp_path, command_name, summary):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "study.toml").write_text("mine")
    done = invoke(command_name, study, "--out", "mine")
    assert done.exit_code == 2
    said = rf"mine.study\.toml: belongs to no results of this command \(there is no {summary}\.json beside it\)"
    assert re.search(said, done.stderr)
    assert (tmp_path / "mine" / "study.toml").read_text() == "mine"
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["study.toml"]


@pytest.mark.parametrize("name", ["estimate.h5", "parameters.csv", "report.html", "study_path.txt"])
def test_the_folder_is_refused_before_the_study_is_read(study, tmp_path, name):
    """A study may run a solver as it is read; one that is not there is not even missed."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / name).write_text("mine")
    done = invoke("identify", study.with_name("missing.toml"), "--out", "mine")
    assert done.exit_code == 2
    assert f"{name}: belongs to no results of this command" in done.stderr
    assert [path.read_text() for path in (tmp_path / "mine").iterdir()] == ["mine"]


def test_a_page_of_the_user_stays_where_a_command_writes_none(tmp_path):
    """`motion` has no page, however often it runs; `modes` removes that of its own earlier results only."""
    frame, modal = Path(__file__).parent.parent.parent / "examples" / "motion_of_a_frame", tmp_path / "frf.npz"
    write_record(modal, chain_record())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "report.html").write_text("mine")
    for words in (*(("motion", frame / "study.toml"),) * 2, ("modes", modal, "--no-report")):
        assert invoke(*words, "--out", tmp_path / "mine").exit_code in (0, 1)
        assert (tmp_path / "mine" / "report.html").read_text() == "mine"
    assert (tmp_path / "mine" / "modes.json").exists()
    for words, is_there in (((), True), (("--no-report",), False)):
        assert invoke("modes", modal, *words, "--out", tmp_path / "theirs").exit_code in (0, 1)
        assert (tmp_path / "theirs" / "report.html").exists() is is_there


def test_an_error_of_the_system_is_one_line(study, monkeypatch):
    def failing(*_arguments):
        raise OSError(errno.EIO, "Input/output error", "disk")

    monkeypatch.setattr("structid.study.schema.study.load_study", failing)
    done = invoke("check", study)
    assert done.exit_code == 2
    assert done.stderr == "error: disk: Input/output error; check the disk and the permissions\n"


def test_an_interruption_exits_130_and_leaves_nothing(study, tmp_path):
    code = (
        "import sys, time, structid.study.run.run as run, structid.cli.app as cli\n"
        "def waiting(*a):\n    print('started', flush=True)\n    time.sleep(600)\n"
        "run.identify_together = waiting\n"
        f"sys.argv = ['structid', 'identify', {str(study)!r}]\n"
        "cli.main()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=ENVIRONMENT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job inherits "ignored"
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 130
    assert "interrupted" in errors
    assert "Traceback" not in errors
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study"]


def test_a_reader_that_leaves_is_no_traceback(study, tmp_path):
    words = f"{sys.executable} -m structid check {study} | true"
    done = subprocess.run(words, shell=True, capture_output=True, text=True, env=ENVIRONMENT, cwd=tmp_path, check=False)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("arguments", [["identify"], ["check", "a", "b"], ["nothing"], ["identify", "a", "--nothing"]])
def test_wrong_usage_exits_2(arguments):
    done = invoke(*arguments)
    assert done.exit_code == 2
    assert "Usage:" in done.stderr


def test_version_and_help_with_examples():
    version = command("--version")
    assert (version.returncode, version.stdout) == (0, f"structid {structid.__version__}\n")
    for name in ("identify", "check", "convert"):
        text = invoke(name, "--help").stdout
        assert "Examples:" in text
        assert f"\n    structid {name} " in text


@pytest.mark.parametrize("suffix", [".h5", ".mat", ".csv", ".uff"])
def test_convert_there_and_back_keeps_the_numbers(tmp_path, suffix):
    record = chain_record()
    write_record(tmp_path / "a.npz", record)
    there = invoke("convert", tmp_path / "a.npz", tmp_path / f"b{suffix}")
    assert (there.exit_code, there.stderr) == (0, "")
    assert "accelerance, 230 lines, 2 outputs, 1 inputs" in there.stdout
    assert invoke("convert", tmp_path / f"b{suffix}", tmp_path / "c.npz").exit_code == 0
    back = read_record(tmp_path / "c.npz")
    np.testing.assert_allclose(back.values, record.values, rtol=1e-6)  # UFF keeps single precision at the worst
    assert back.outputs == record.outputs


def test_convert_reads_bare_arrays_by_its_options(tmp_path):
    values = np.random.default_rng(0).standard_normal((64, 2))
    np.save(tmp_path / "a.npy", values)
    done = invoke(
        "convert", tmp_path / "a.npy", tmp_path / "b.npz", "--sampling-rate", 100, "--channels", "1X+,2Y-", "--units",
        "g,N",
    )  # fmt: skip
    assert (done.exit_code, done.stderr) == (0, "")
    record = read_record(tmp_path / "b.npz")
    assert record.sampling_rate == 100
    assert list(map(str, record.channels)) == ["1X+", "2Y-"]
    assert record.quantities == ("acceleration", "force")
    np.testing.assert_allclose(record.values, values * [9.80665, 1.0], rtol=1e-14)
    named = ["--sampling-rate", 100, "--channels", "1X+,1X+", "--quantity", "velocity,force"]
    assert invoke("convert", tmp_path / "a.npy", tmp_path / "d.npz", *named).exit_code == 0
    assert read_record(tmp_path / "d.npz").quantities == ("velocity", "force")
    bare(tmp_path)
    options = ["--array", "h", "--frequency-array", "f", "--outputs", "1X,3X", "--inputs", "3X"]
    frf = invoke("convert", tmp_path / "bare.npz", tmp_path / "c.npz", *options, "--kind", "mobility")
    assert (frf.exit_code, frf.stderr) == (0, "")
    assert read_record(tmp_path / "c.npz").kind == "mobility"


@pytest.mark.parametrize(
    "source, target, words",
    [
        ("none.npz", "b.npz", ["none.npz: there is no such file"]),
        ("frf.npz", "b.xyz", ["b.xyz", "'.xyz' is of no known format"]),
        ("frf.npz", "frf.npz", ["is the file that is read"]),
        ("frf.npz", "none/b.npz", ["does not exist"]),
    ],
)
def test_convert_names_what_is_wrong(tmp_path, monkeypatch, source, target, words):
    monkeypatch.chdir(tmp_path)
    write_chain(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    done = invoke("convert", source, target)
    assert done.exit_code == 2
    assert done.stderr.startswith("error: ")
    for word in words:
        assert word in done.stderr
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_what_steers_a_terminal_is_shown_by_its_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = invoke("check", "a\x1b[31mb.toml")
    assert done.exit_code == 2
    assert "a\\x1b[31mb.toml: there is no such file" in done.stderr
    assert "\x1b" not in done.stderr
