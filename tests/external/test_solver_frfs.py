"""Studies whose solver gives FRFs itself: answers and intervals beside exact ones, far starts, faults, and bad input."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from chain_solver import chain
from solver_cases import CHAIN_SOLVER, TRUE, parameter, unknown
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.dof import parse_dofs
from structid.core.errors import FileError
from structid.external.deck import with_frequencies
from structid.external.frf_model import FrfsOut
from structid.external.solved import Units
from structid.fem.elements.matrix_group import FrfRuns
from structid.records import FrfRecord
from structid.records.formats import write_record
from structid.study.run.run import run_study
from structid.study.schema.study import load_study
from structid.workbench.work.functions import answer_json

RUN = CliRunner()
ETA = 0.02
DECAY = '[[record.channel_error]]\nproperty = "window_decay"\nstart = 1.0\n'
MATRICES = 'stiffness = "{stem}_k.mtx"\nmass = "{stem}_m.mtx"\ndofs = ["1X", "2X", "3X", "4X", "5X", "6X"]'


def receptance(values: dict[str, float], frequency: np.ndarray, eta: float) -> np.ndarray:
    mass, stiffness = map(np.array, chain(values, 6))
    dynamic = stiffness * (1 + 1j * eta) - (2 * np.pi * frequency[:, None, None]) ** 2 * mass
    return np.linalg.inv(dynamic)[:, [0, 2, 5]][:, :, [2]]


def study(
    folder: Path,
    start: dict[str, float],
    options: str = "",
    more: str = "",
    eta: float = ETA,
    noise: float = 0.01,
    lines: int = 160,
    gives: str = "frfs",
    kind: str = "receptance",
) -> Path:
    """An exact chain whose FRFs were measured from 0.3 to 11.5 Hz, noise in parts of each value; six resonances."""
    shutil.copy(CHAIN_SOLVER, folder)
    deck = "".join(f"{name} = {{{{{name}}}}}\n" for name in start)
    deck += "".join(f"{name} = {value!r}\n" for name, value in (TRUE | {"eta": eta}).items() if name not in start)
    (folder / "chain.txt").write_text(deck)
    frequency = np.linspace(0.3, 11.5, lines)
    clean = receptance(TRUE, frequency, eta) * (2j * np.pi * frequency[:, None, None]) ** (kind == "mobility")
    real, imaginary = np.random.default_rng(4).standard_normal((2, *clean.shape))
    size = noise * np.abs(clean)
    values = clean + size * (real + 1j * imaginary) / np.sqrt(2)
    record = FrfRecord(frequency, values, ("1X", "3X-", "6X"), ("3X",), kind, variance=size**2)
    write_record(folder / "frf.npz", _turned(record))
    own = "".join(parameter(name, value) + unknown(name) for name, value in start.items())
    files = MATRICES if gives == "matrices" else 'frfs = "{stem}.csv"'
    structure = "[structure]\ntolerance = 0\n"
    path = folder / "study.toml"
    path.write_text(
        f"""
{structure}
[structure.solver]
deck = "chain.txt"
command = "{sys.executable} {{study}}/chain_solver.py {{deck}} {gives} {options}"
gives = "{gives}"
{files}
{more}

{own}
[record]
path = "frf.npz"
calibration = 0
"""
    )
    return path


def _turned(record: FrfRecord) -> FrfRecord:
    """The second sensor reads against its direction, as its name 3X- says."""
    values = np.array(record.values)
    values[:, 1] *= -1
    return FrfRecord(record.frequency, values, record.outputs, record.inputs, record.kind, variance=record.variance)


def identified(path: Path, *flags: str) -> dict:
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(path.parent / "out"), "--no-report", *flags])
    assert done.exit_code == 0, done.stderr + done.stdout
    return json.loads((path.parent / "out" / "estimate.json").read_text())


def values(found: dict) -> dict[str, float]:
    return {one["property"]: one["value"] for one in found["parameters"]}


def finished(folder: Path) -> dict[str, float]:
    return {one.parent.name: one.stat().st_mtime_ns for one in folder.glob("study.runs/*/run.json")}


@pytest.mark.parametrize("kind", [pytest.param("receptance", marks=pytest.mark.long), "mobility"])
def test_answer_and_intervals_are_those_of_exported_matrices(tmp_path, kind):
    own, exact = tmp_path / "own", tmp_path / "exact"
    own.mkdir()
    exact.mkdir()
    found = identified(study(own, {"k1": 1150.0, "k2": 830.0}, kind=kind))
    path = study(exact, {"k1": 1150.0, "k2": 830.0}, gives="matrices", kind=kind)
    held = f'[[unknown]]\nproperty = "loss_factor"\nelements = "model"\nstart = {ETA}\nfixed = true\n'
    path.write_text(path.read_text().replace("[record]", held + "[record]"))
    true = identified(path)
    for ours, theirs in zip(found["parameters"], true["parameters"], strict=True):
        assert ours["value"] == pytest.approx(theirs["value"], abs=0.02 * theirs["std"])
        assert ours["value"] == pytest.approx(TRUE[ours["property"]], rel=1e-3)
        assert ours["std"] == pytest.approx(theirs["std"], rel=0.01)
    assert found["parameters"][0]["initial"] == 1150.0
    assert found["solver"]["largest_difference"] < 1e-6


@pytest.mark.parametrize(
    "start, eta",
    [
        pytest.param({"k1": 0.75, "k2": 1.28}, 0.01, marks=pytest.mark.long),
        pytest.param({"k1": 1.3, "k2": 1.25}, 0.01, marks=pytest.mark.long),
        ({"k1": 0.72, "k2": 0.74}, 0.002),  # lines 40 half-bandwidths of the lowest resonance apart
    ],
)
def test_lightly_damped_resonances_are_found_from_a_quarter_off(tmp_path, start, eta):
    begun = {name: part * TRUE[name] for name, part in start.items()}
    path = study(tmp_path, begun, eta=eta, noise=0.001, lines=300)
    found = identified(path)
    assert values(found) == pytest.approx(TRUE, rel=1e-4)
    assert found["parameters"][0]["initial"] == begun["k1"]
    assert len(finished(tmp_path)) < 150
    assert "with steps k1 2.4, k2 1.6" in found["solver"]["facts"][0]  # wide ones on the way only


def test_a_solver_that_has_no_answer_beside_the_way_is_survived(tmp_path):
    begun = {"k1": 0.8 * TRUE["k1"], "k2": 1.22 * TRUE["k2"]}
    path = study(tmp_path, begun, "--fail-above 1230 --log {study}/log", "retries = 0")
    assert values(identified(path)) == pytest.approx(TRUE, rel=2e-3)
    asked = (tmp_path / "log").read_text().splitlines()
    assert len(asked) > len(finished(tmp_path))  # some had no answer


def test_damping_is_found_too_and_few_digits_do(tmp_path):
    path = study(tmp_path, {"k1": 1000.0, "k2": 900.0, "eta": 0.03}, "--digits 6")
    found = values(identified(path))
    assert found == pytest.approx(TRUE | {"eta": ETA}, rel=5e-3)


@pytest.mark.slow  # modes of a solver go the same way in test_solver_study.py
def test_runs_that_fail_and_kills_change_nothing(tmp_path):
    plain, broken = tmp_path / "plain", tmp_path / "broken"
    plain.mkdir()
    broken.mkdir()
    start = {"k1": 1000.0, "k2": 900.0}
    expected = identified(study(plain, start))
    path = study(broken, start, "--log {study}/log --fail 0.2 --sleep 0.1", "retries = 12")
    command = [sys.executable, "-m", "structid", "identify", str(path), "--out", str(broken / "out"), "--no-report"]
    process = subprocess.Popen([*command, "--workers", "2"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(finished(broken)) < 8 and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    time.sleep(0.5)  # orphans of the killed run end
    before = finished(broken)
    assert len(before) >= 8
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert values(json.loads((broken / "out" / "estimate.json").read_text())) == values(expected)
    after = finished(broken)
    assert {key: after[key] for key in before} == before
    assert len(after) == len(finished(plain))
    assert len((broken / "log").read_text().splitlines()) > len(after)  # some failed


@pytest.mark.parametrize(
    "wrong, message",
    [
        ("channel", "has no FRF of sensor 6X+, which the record has; its sensors are 1X+, 3X+"),
        ("nan", "chain.csv"),
        ("lines", "16 of the 160 lines of the record are missing, 0.3, 1.004"),
        ("real", "the FRFs have no imaginary part: write real and imaginary parts"),
        ("parts", "im"),
    ],
)
def test_frfs_that_cannot_be_used_are_named_with_a_remedy(tmp_path, wrong, message):
    path = study(tmp_path, TRUE, f"--wrong {wrong}", "retries = 0")
    done = RUN.invoke(cli.app, ["check", str(path)])
    words = " ".join(done.stderr.split())
    assert done.exit_code == 2, words
    assert message in words, words
    assert "chain.csv" in words, words
    assert "[structure.solver]" in words, words
    assert not finished(tmp_path)


def test_half_a_file_is_refused_and_finished_runs_are_kept(tmp_path):
    path = study(tmp_path, TRUE, "--half", "retries = 0")
    done = RUN.invoke(cli.app, ["check", str(path)])
    assert done.exit_code == 2
    assert "cut short" in " ".join(done.stderr.split())
    path = study(tmp_path, TRUE, "--fail-above 1200", "retries = 0")
    path.write_text(path.read_text().replace("value = 1200.0", "value = 1200.0\nbounds = [1200.0, 1300.0]"))
    done = RUN.invoke(cli.app, ["check", str(path)])
    assert done.exit_code == 2
    assert len(finished(tmp_path)) >= 3


@pytest.mark.parametrize(
    "edit, message",
    [
        (lambda t: t.replace('frfs = "{stem}.csv"', ""), "`frfs` is missing"),
        (lambda t: t.replace('frfs = "{stem}.csv"', 'frfs = "{stem}.csv"\nmodes = "x.csv"'), 'belongs to `gives = "modes"`'),
        (lambda t: t.replace('frfs = "{stem}.csv"', 'frfs = "{stem}.csv"\nlength_unit = "mm"'), "says its units and loads itself"),
        (lambda t: t[: t.index("[record]")], "needs a [record]"),
        (lambda t: t + "[record.time]\n", "time histories are fitted by matrices or modes"),
        (lambda t: t + DECAY, "'model' is known by its FRFs alone, which a window's decay cannot be computed with"),
        (lambda t: t.replace("tolerance = 0\n", "tolerance = 0.02\n"), "leave it out, or write 0"),
        (lambda t: t.replace("tolerance = 0\n", 'fixed = ["1"]\n'), "put it in the deck"),
    ],
)  # fmt: skip
def test_a_study_that_asks_for_more_than_frfs_is_refused(tmp_path, edit, message):
    path = study(tmp_path, TRUE, more="retries = 0")
    path.write_text(edit(path.read_text()))
    command = "check" if "[record]" in path.read_text() else "plan"
    done = RUN.invoke(cli.app, [command, str(path)])
    words = " ".join(done.stderr.split())
    assert done.exit_code == 2, words
    assert message in words, words


def test_check_says_what_frfs_alone_do_not_tell(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = RUN.invoke(cli.app, ["check", str(study(tmp_path, {"k1": 1180.0, "k2": 810.0}))])
    words = " ".join(done.stdout.split())
    assert done.exit_code == 0
    assert "FRFs of a solver alone, which tell no masses, modes or mesh" in words
    assert "160 lines from 0.3 to 11.5 Hz, 3 x 1 FRFs" in words
    assert "warning" not in words, words


def test_results_say_that_the_model_of_the_solver_is_not_among_what_intervals_include(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = study(tmp_path, {"k1": 1180.0, "k2": 810.0})
    path.write_text(path.read_text().replace("calibration = 0\n", ""))
    words = "± includes 1 % of the calibration; the model behind the FRFs of the solver is taken as exact"
    assert words in " ".join(RUN.invoke(cli.app, ["check", str(path)]).stdout.split())
    assert words in run_study(load_study(path)).identification.assumption


@pytest.mark.long
def test_commands_go_their_way_with_frfs_alone_and_say_which_causes_they_cannot_look_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = study(tmp_path, {"k1": 1180.0, "k2": 810.0})
    for command in ("doctor", "correlate", "plan"):
        done = RUN.invoke(cli.app, [command, str(path)])
        assert done.exit_code == 0, done.stderr
    (tmp_path / "chain.txt").write_text((tmp_path / "chain.txt").read_text() + "t = 1.2\n")  # a model that is wrong
    done = RUN.invoke(cli.app, ["explain", str(path), "--out", str(tmp_path / "out")])
    assert done.exit_code in (0, 3), done.stdout + done.stderr
    page = (tmp_path / "out" / "report.html").read_text()
    assert "causes were not looked for: that needs masses and stiffnesses" in page
    assert "its modes are not known" in page


@pytest.mark.parametrize("name", ["run.uff", "run.npz", "run.csv", "run.h5"])
def test_files_of_records_are_read_at_the_lines_and_in_the_senses_that_are_needed(tmp_path, name):
    frequency = np.linspace(0.3, 11.5, 160)
    clean = receptance(TRUE, frequency, ETA)
    made = FrfRecord(frequency, clean, ("1X", "3X", "6X"), ("3X",), "receptance").as_kind("accelerance")
    write_record(
        tmp_path / name, _turned(FrfRecord(made.frequency, made.values, ("1X", "3X-", "6X"), ("3X",), made.kind))
    )
    out = FrfsOut(name, frequency[10:60:2], parse_dofs(["6X", "3X"]), parse_dofs(["3X-"]))
    np.testing.assert_allclose(out.read(tmp_path), -clean[10:60:2][:, [2, 1]], rtol=1e-6)


def punched(frequency: np.ndarray, values: np.ndarray, by_point: bool, polar: bool = False) -> str:
    """Z of points 5 and 7 under two subcases, as Nastran punches them; (n_lines, 2, 2)."""

    def point(first: str, z: complex) -> list[str]:
        pair = (abs(z), np.degrees(np.angle(z))) if polar else (z.real, z.imag)
        rows = []
        for k, part in enumerate(pair):
            rows.append((f"{first:>16} G" if k == 0 else "-CONT-            ", 0.0, 0.0, part))
            rows.append(("-CONT-            ", 0.0, 0.0, 0.0))
        return [f"{head:<18}" + "".join(f"{x:18.9E}" for x in numbers) for head, *numbers in rows]

    lines: list[str] = []
    head = ["$TITLE   = CHAIN", "$SUBTITLE=", "$LABEL   =", "$DISPLACEMENTS"]
    head.append("$MAGNITUDE-PHASE OUTPUT" if polar else "$REAL-IMAGINARY OUTPUT")
    for case in range(2):
        blocks = [5, 7] if by_point else frequency.tolist()
        for b, block in enumerate(blocks):
            lines += [*head, f"$SUBCASE ID ={case + 1:12d}"]
            lines.append(
                f"$POINT ID ={block:12d}  IDENTIFIED BY FREQUENCY" if by_point else f"$FREQUENCY = {block:16.7E}"
            )
            if by_point:
                rows = [(f"{f:.6E}", values[k, b, case]) for k, f in enumerate(frequency)]
            else:
                rows = [(str(node), values[b, k, case]) for k, node in enumerate((5, 7))]
            lines += [line for first, z in rows for line in point(first, z)]
    return "".join(f"{line:<72}{k:8d}\n" for k, line in enumerate(lines, 1))


@pytest.mark.parametrize("by_point, polar", [(True, False), (False, False), (True, True)])
def test_nastran_punches_are_read_whole_or_not_at_all(tmp_path, by_point, polar):
    frequency = np.array([1.5, 2.25, 4.0])
    real, imaginary = np.random.default_rng(1).standard_normal((2, 3, 2, 2))
    values = real + 1j * imaginary
    path = tmp_path / "run.pch"
    path.write_text(punched(frequency, values, by_point, polar))
    loads, units = parse_dofs(["5Z", "7Z"]), Units("mm", "kN")
    out = FrfsOut("run.pch", frequency[1:], parse_dofs(["7Z", "5Z"]), parse_dofs(["5Z", "7Z"]), loads, units)
    np.testing.assert_allclose(out.read(tmp_path), 1e-6 * values[1:, ::-1], rtol=1e-7)
    text = path.read_text()
    for lines in (3, 30, 40):
        path.write_text("".join(text.splitlines(keepends=True)[:-lines]))
        with pytest.raises(FileError, match=r"run\.pch"):
            out.read(tmp_path)
    path.write_text(text)
    with pytest.raises(FileError, match="holds 2 subcases, and `loads` names 1"):
        FrfsOut("run.pch", frequency, parse_dofs(["7Z"]), parse_dofs(["5Z"]), parse_dofs(["5Z"]), units).read(tmp_path)


PUNCHES = """
import sys
from pathlib import Path
k = float(Path(sys.argv[1]).read_text().splitlines()[0].split("=")[1])
lines = ["$TITLE   =", "$DISPLACEMENTS", "$REAL-IMAGINARY OUTPUT", "$POINT ID = 5  IDENTIFIED BY FREQUENCY"]
for f in Path("frequencies.csv").read_text().split():
    z = 1 / (k * (1 + 0.02j) - (6.283185307179586 * float(f)) ** 2)
    lines += [f"{f} G 0.0 0.0 {z.real:.9e}", "-CONT- 0.0 0.0 0.0", f"-CONT- 0.0 0.0 {z.imag:.9e}", "-CONT- 0.0 0.0 0.0"]
Path("deck.pch").write_text("\\n".join(lines) + "\\n")
"""


def test_the_answer_says_how_axes_of_punched_frfs_were_taken(tmp_path):
    (tmp_path / "punches.py").write_text(PUNCHES)
    (tmp_path / "deck.txt").write_text("k = {{k}}\n")
    frequency = np.linspace(2.0, 8.0, 40)
    values = 1 / (1000.0 * (1 + 0.02j) - (2 * np.pi * frequency) ** 2)
    write_record(tmp_path / "frf.npz", FrfRecord(frequency, values[:, None, None], ("5Z",), ("5Z",), "receptance"))
    (tmp_path / "study.toml").write_text(
        f"""
[structure.solver]
deck = "deck.txt"
command = "{sys.executable} {{study}}/punches.py {{deck}}"
gives = "frfs"
frfs = "{{stem}}.pch"
loads = ["5Z"]

{parameter("k", 900.0)}{unknown("k")}
[record]
path = "frf.npz"
"""
    )
    solved = load_study(tmp_path / "study.toml").solved
    assert solved is not None
    assert "taken as basic" in solved.facts[1]


def test_records_with_lines_and_sensors_of_their_own_are_fitted_together(tmp_path):
    path = study(tmp_path, {"k1": 1150.0, "k2": 830.0})
    frequency = np.linspace(2.0, 9.0, 55)
    other = receptance(TRUE, frequency, ETA)[:, [2]]
    record = FrfRecord(frequency, other, ("6X",), ("3X",), "receptance", variance=(0.01 * np.abs(other)) ** 2)
    write_record(tmp_path / "other.npz", record)
    text = path.read_text().replace("[record]", '[[record]]\nname = "first"')
    path.write_text(text + '[[record]]\nname = "other"\npath = "other.npz"\n[method]\nband = [0.5, 8.0]\n')
    assert values(identified(path)) == pytest.approx(TRUE, rel=2e-3)


def test_looking_at_a_study_in_the_workbench_reads_what_is_kept(tmp_path):
    path = study(tmp_path, {"k1": 1180.0, "k2": 810.0})
    assert RUN.invoke(cli.app, ["check", str(path)]).exit_code == 0
    for name in ("check", "scene", "line"):
        found = json.loads(answer_json(name, str(tmp_path), {"study": path.name}))
        assert "error" not in found, found


def test_lines_stand_beside_the_deck_and_where_it_marks_them():
    made = with_frequencies({"a.bdf": "FREQ,1,{{frequency}}\nMAT1,1,{{E}}\n", "b": "x {{ frequency:8 }}|"}, [1.5, 20.0])
    assert made["a.bdf"] == "FREQ,1,1.5\nFREQ,1,20.\nMAT1,1,{{E}}\n"
    assert made["b"] == "x 1.5     |\nx 20.     |\n"
    assert made["frequencies.csv"] == "1.5\n20.\n"


@pytest.mark.parametrize("changes", [(0.1, -0.1), (0.1, 0.2)])
def test_slopes_are_those_at_the_centre_also_where_a_bound_is_near(changes):
    frequency = np.linspace(1.0, 3.0, 50)

    def one(k: float) -> np.ndarray:
        return (1 / (k * (1 + 0.05j) - (2 * np.pi * frequency) ** 2))[:, None, None]

    runs = np.array([[one(100 + change) for change in changes]])
    made = FrfRuns(frequency, (), (), one(100.0), {"k": 100.0}, np.array([changes]), runs)
    found, slope = made.evaluated(np.array([100.0]))
    np.testing.assert_array_equal(found, one(100.0))
    np.testing.assert_allclose(slope[..., 0], -(1 + 0.05j) * one(100.0) ** 2, rtol=2e-3)
