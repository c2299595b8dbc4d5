"""`structid doctor`: what is installed, what a study needs, and the refusal of what cannot fit."""

from __future__ import annotations

import re
import resource
import subprocess
import sys
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.cli.commands.doctor import installation
from structid.cli.console import RunProgress, clock
from structid.core.errors import InputError
from structid.records import FrfRecord
from structid.study.run import resources as resources_module
from structid.study.run.resources import available_bytes, expected, gigabytes, measured_needs, require_room, sizes
from structid.study.run.run import run_study
from structid.study.run.start import study_problems
from structid.study.schema.study import load_study
from study_cases import CHAIN, exact_frf, write_chain

RUN = CliRunner()


def long_record(n_lines: int) -> FrfRecord:
    frequency = np.linspace(0.5, 12, n_lines)
    values = exact_frf(frequency, [0, 2], [2])
    return FrfRecord(frequency, values, ("1X", "3X"), ("3X",), "accelerance")


def test_doctor_names_versions_factorizers_threads_and_memory():
    done = RUN.invoke(cli.app, ["doctor"])
    assert done.exit_code == 0
    for word in (f"numpy {np.__version__}", "SuperLU", "processors", "memory:", "GB free"):
        assert word in done.stdout
    assert installation().processors >= 1


def test_doctor_says_what_is_not_installed_and_what_it_is_for(monkeypatch):
    monkeypatch.setattr("structid.cli.commands.doctor.OPTIONAL", {"no-such-package": "nothing (extra `none`)"})
    assert "not installed: no-such-package: nothing (extra `none`)" in RUN.invoke(cli.app, ["doctor"]).stdout


def test_doctor_tells_the_sizes_of_a_study(tmp_path):
    path = write_chain(tmp_path, CHAIN + 'uniqueness_starts = 3\nintervals = "bootstrap"\n')
    done = RUN.invoke(cli.app, ["doctor", str(path), "--workers", "2"])
    assert done.exit_code == 0, done.stderr
    assert "3 degrees of freedom" in done.stdout
    assert "8 parameters; 230 lines, 2 channels; 920 residuals" in done.stdout
    assert f"one Jacobian {gigabytes(8 * 920 * 8)}" in done.stdout
    assert "4 starts, with its intervals" in done.stdout
    assert "on 2 workers" in done.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["chain.toml", "frf.npz"]


def test_an_iteration_takes_what_was_predicted_to_its_order(tmp_path, monkeypatch):
    """4096 of 20000 lines are measured, by processor time here, which other work on the machine does not add to."""
    monkeypatch.setattr(time, "perf_counter", time.process_time)
    study = load_study(write_chain(tmp_path, record=long_record(20_000)))
    problems = study_problems(study)
    predicted = measured_needs(study, problems)
    theta = problems[0].theta_start
    problems[0].linearize(theta)
    taken = []
    for _ in range(5):
        begun = time.process_time()
        problems[0].linearize(theta)
        taken.append(time.process_time() - begun)
    assert 0.1 < predicted.iteration_seconds / min(taken) < 10
    assert predicted.search_seconds == resources_module.USUAL_ITERATIONS * predicted.iteration_seconds
    assert predicted.search_and_intervals(4) < predicted.search_and_intervals(1) or predicted.starts == 1


@pytest.mark.parametrize("stiffer", [1.0, 1.3])
def test_a_search_that_takes_seconds_is_tried(tmp_path, monkeypatch, stiffer):
    """It says whether causes of a misfit will be sought; of one that takes longer nobody knows."""
    monkeypatch.setattr(resources_module, "_start_seconds", lambda: 2.0)
    monkeypatch.setattr(resources_module, "_TRIED_SECONDS", 1e6)  # however busy the machine is
    frequency = np.linspace(0.5, 12, 230)
    values = exact_frf(frequency, [0, 2], [2])
    values[frequency > 6, 1] *= stiffer
    study = load_study(write_chain(tmp_path, record=FrfRecord(frequency, values, ("1X", "3X"), ("3X",), "accelerance")))
    begun = time.perf_counter()
    _, found = expected(study)
    assert found.is_tried
    assert 0 < found.search < time.perf_counter() - begun
    assert found.around > 2.0
    assert (found.causes > 0) == (stiffer > 1)
    assert found.least == found.most == pytest.approx(found.around + found.search + found.causes)
    monkeypatch.setattr(resources_module, "_TRIED_SECONDS", 1e-3)
    _, found = expected(study)
    assert not found.is_tried
    assert found.least < found.most


def test_the_memory_predicted_covers_the_peak_of_an_evaluation(tmp_path):
    """tracemalloc sees all arrays of NumPy; the prediction from 4096 lines is within 30 % for 20000."""
    import tracemalloc

    study = load_study(write_chain(tmp_path, record=long_record(20_000)))
    problem = study_problems(study)[0]
    predicted = measured_needs(study, [problem]).bytes_needed
    problem.linearize(problem.theta_start)
    tracemalloc.start()
    problem.linearize(problem.theta_start)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = sizes([problem])
    assert size.jacobian_bytes == 8 * 2 * 2 * 20_000 * 8
    assert predicted > peak
    assert predicted < 1.3 * (peak + size.record_bytes + 2 * size.jacobian_bytes) + 50e6


def test_a_study_that_cannot_fit_is_refused_with_the_numbers(tmp_path, monkeypatch):
    study = load_study(write_chain(tmp_path))
    problems = study_problems(study)
    least = sizes(problems).least_bytes
    require_room(study, problems, least)
    with pytest.raises(InputError, match=r"needs at least .* and .* are free: 3 arrays of 920 rows x 8 parameters"):
        require_room(study, problems, least - 1)
    monkeypatch.setattr(resources_module, "available_bytes", lambda: 100_000)
    with pytest.raises(InputError, match=r"needs at least 195 kB of memory and 100 kB are free"):
        run_study(study)
    for name in ("identify", "doctor"):
        done = RUN.invoke(
            cli.app, [name, str(study.path), "--out", str(tmp_path / "r")][: 4 if name == "identify" else 2]
        )
        assert done.exit_code == 2
        assert "100 kB are free" in done.stderr
    assert not (tmp_path / "r").exists()


def test_doctor_refuses_what_a_few_lines_show_to_be_too_large(tmp_path, monkeypatch):
    path = write_chain(tmp_path)
    monkeypatch.setattr("structid.study.run.resources.available_bytes", lambda: 250_000)
    done = RUN.invoke(cli.app, ["doctor", str(path)])
    assert done.exit_code == 2
    assert re.search(r"needs about .* of memory and 250 kB are free; take fewer lines", done.stderr)
    assert "one Jacobian" in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not keep this limit")
def test_the_limit_of_the_process_counts():
    code = "from structid.study.run.resources import available_bytes; print(available_bytes())"
    limit = 3_000_000_000
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )
    assert 0 < int(done.stdout) < limit
    assert available_bytes() > 0


def test_the_limit_of_a_control_group_counts(tmp_path, monkeypatch):
    """Of both layouts; what its files hold in memory is free."""
    monkeypatch.setattr(resources_module, "_GROUP", tmp_path)
    (tmp_path / "memory.max").write_text("1000000\n")
    (tmp_path / "memory.current").write_text("400000\n")
    (tmp_path / "memory.stat").write_text("anon 1\ninactive_file 50000\n")
    assert available_bytes() == 650_000
    (tmp_path / "memory.max").write_text("max\n")
    assert available_bytes() > 650_000
    (tmp_path / "memory.max").unlink()
    (tmp_path / "memory").mkdir()
    (tmp_path / "memory" / "memory.limit_in_bytes").write_text("900000\n")
    (tmp_path / "memory" / "memory.usage_in_bytes").write_text("100000\n")
    (tmp_path / "memory" / "memory.stat").write_text("total_inactive_file 70000\n")
    assert available_bytes() == 870_000


def test_progress_tells_the_time_left(monkeypatch):
    """Ten tasks of two seconds each, then iterations of one second with a limit of 100."""
    now = [0.0]
    monkeypatch.setattr("structid.cli.console.time.monotonic", lambda: now[0])
    said: list[str] = []

    progress = RunProgress(100, lambda _name, _done, _total, words: said.append(words))
    for done in range(11):
        progress.tasks("bootstrap replicates", done, 10)
        now[0] += 2.0
    assert said[4] == "bootstrap replicates: 4 of 10, about 12 s left"
    assert said[10] == "bootstrap replicates: 10 of 10"
    for iteration in range(1, 4):
        progress.search("final", iteration, 12.5)
        now[0] += 1.0
    assert said[-1] == "final: iteration 3, 1 s each, misfit 12.5"


@pytest.mark.parametrize(("seconds", "words"), [(0.345, "0.34 s"), (59.0, "59 s"), (185, "3:05 min"), (7800, "2:10 h")])
def test_durations_have_the_unit_that_suits(seconds, words):
    assert clock(seconds) == words
