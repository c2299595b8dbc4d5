"""Segments of records on disk reduced by workers: the digits of one, whoever does what and in whatever order."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
from test_study_motion import STUDY, act, written

from structid.core.errors import InputError
from structid.forward.motion.fit import motion_fit
from structid.forward.motion.stream import load_motion_fit, motion_solution
from structid.inversion.regression.local_reduction import FoldingKernels
from structid.records import TimeRecord
from structid.records.formats import read_record, write_record
from structid.records.on_disk import open_record
from structid.study.run import motion
from structid.study.run.long_run import start_workers
from structid.study.run.motion import MotionTaskData, reduced_alone, reduced_on, segments, unusable
from structid.study.run.workers import InProcess, Processes
from structid.study.schema.study import load_study

ANSWER = 6 * 5 * 5 * 8  # bytes of the triangles: four columns and a right-hand side a degree of freedom


@pytest.fixture(autouse=True)
def short_segments(monkeypatch):
    """About 24 samples of 18 channels each."""
    monkeypatch.setattr(motion, "SEGMENT_BYTES", 3500)
    monkeypatch.setattr(motion, "_TIMES_THE_ANSWER", 1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> MotionTaskData:
    """Two records, of 137 and of 60 samples."""
    folder = tmp_path_factory.mktemp("parts")
    study = load_study(written(folder, n=137))
    second = folder / "second.h5"
    values = read_record(folder / "motion.h5")
    assert isinstance(values, TimeRecord)
    write_record(second, replace(values, values=values.values[30:90] * 0.7))
    records = tuple(open_record(path) for path in (folder / "motion.h5", second))
    return MotionTaskData(study.structure, study.parameters, records, FoldingKernels("numpy"), 11)


def start(whole: MotionTaskData):
    return motion_fit(whole.structure, whole.unknown)


def bits(fit) -> tuple[bytes, bytes, int, int]:
    return fit.state.triangles.tobytes(), fit.energy.tobytes(), fit.state.n_rows, fit.n_samples


@pytest.mark.parametrize("done", [0, 1, 22, 100, 136, 137, 140, 197])
def test_stretches_hold_every_sample_that_is_left_once(whole, done):
    parts = segments(whole.records, ANSWER, done)
    left = [137 * number + sample for number, first, last in parts for sample in range(first, last)]
    assert left == list(range(done, 197))
    assert len(segments(whole.records, ANSWER)) == 7
    assert set(parts[1:]) <= set(segments(whole.records, ANSWER))


def test_stretches_are_few_where_the_answer_is_large(whole):
    assert len(segments(whole.records, 10_000)) == 2
    assert len(segments(whole.records, 10)) == 7


class Backwards(InProcess):
    """Tasks from the last to the first."""

    def completed(self, task, shared, items):
        return super().completed(task, shared, dict(reversed(items.items())))


def test_any_number_of_workers_gives_the_bits_of_one_in_any_order(whole):
    """And the values of the pass without segments to 1e-12."""
    one = reduced_on(InProcess(), start(whole), whole)
    assert bits(reduced_on(Backwards(), start(whole), whole)) == bits(one)
    pool = Processes(2)
    assert bits(reduced_on(pool, start(whole), whole)) == bits(one)
    pool.close()
    alone = reduced_alone(start(whole), whole)
    assert (one.n_samples, one.state.n_rows) == (alone.n_samples, alone.state.n_rows) == (197, 197 * 6)
    found, plain = motion_solution(one), motion_solution(alone)
    assert found.values == pytest.approx(plain.values, rel=1e-12)
    assert found.std == pytest.approx(plain.std, rel=1e-11)
    assert one.energy == pytest.approx(alone.energy, rel=1e-13)


class Stopped(Exception):
    pass


@pytest.mark.parametrize("kind", [InProcess, Backwards])
def test_a_pass_stopped_after_some_stretches_goes_on_to_the_same_bits(whole, tmp_path, kind):
    kept = tmp_path / "state.npz"
    told: list[int] = []

    def stop(done: int, total: int) -> None:
        told.append(done)
        assert total == 197
        if len(told) == 3 and kind is InProcess:
            raise Stopped

    if kind is InProcess:
        with pytest.raises(Stopped):
            reduced_on(kind(), start(whole), whole, kept, stop)
        fit = load_motion_fit(kept, start(whole))
        assert fit.n_samples == told[-1] == 82
    else:
        fit = start(whole)
    assert bits(reduced_on(kind(), fit, whole, kept, stop)) == bits(reduced_on(InProcess(), start(whole), whole))
    assert told[-1] == 197
    assert load_motion_fit(kept, start(whole)).n_samples == 197


def test_a_pass_of_one_process_stopped_inside_a_record_goes_on_where_it_was(whole, tmp_path):
    """Also where another number of workers goes on."""
    kept = tmp_path / "state.npz"

    def stop(done: int, total: int) -> None:
        if done == 159:
            raise Stopped

    with pytest.raises(Stopped):
        reduced_alone(start(whole), whole, kept, stop)
    fit = load_motion_fit(kept, start(whole))
    assert fit.n_samples == 159
    alone = reduced_alone(start(whole), whole)
    assert bits(reduced_alone(fit, whole)) == bits(alone)
    assert motion_solution(reduced_on(InProcess(), fit, whole)).values == pytest.approx(
        motion_solution(alone).values, rel=1e-12
    )


def parameters(folder: Path) -> list[dict[str, str]]:
    with (folder / "parameters.csv").open() as stream:
        return list(csv.DictReader(stream))


def test_the_command_takes_several_records_and_workers(tmp_path):
    text = STUDY.replace('path = "motion.h5"', 'repeats = ["motion.h5", "again.h5"]')
    study = written(tmp_path, text=text.replace("again", "motion"))
    (tmp_path / "motion.h5").rename(tmp_path / "again.h5")
    written(tmp_path, noise=0.02, text=text, n=70)
    for name, words in (("one", ["--workers", 1]), ("two", ["--workers", 2]), ("alone", [])):
        done = act(study, "--out", tmp_path / name, "--engine", "numpy", *words)
        assert done.exit_code == 0, done.output
        assert ("in 2 processes of this machine" in done.output) == (name == "two")
        summary = json.loads((tmp_path / name / "motion.json").read_text())
        assert (summary["samples"], summary["records"], summary["identified"]) == (120, 2, 6)
    one, two, alone = (parameters(tmp_path / name) for name in ("one", "two", "alone"))
    assert one == two
    for mine, plain in zip(one, alone, strict=True):
        assert float(mine["value"]) == pytest.approx(float(plain["value"]), rel=1e-12)
    both = act(study, "--workers", 2, "--scheduler", "tcp://127.0.0.1:9")
    assert both.exit_code == 2
    assert "give --workers or --scheduler" in both.output


def test_workers_that_cannot_reduce_the_records_say_why(tmp_path, whole):
    path = whole.records[0].path
    size = path.stat().st_size
    assert unusable((((str(path), size),), "")) == ""
    assert "there is no such file; put the record where all workers see it" in unusable(((("/no.h5", 1),), ""))
    assert f"has {size} bytes there and 5 here; give workers the same" in unusable((((str(path), 5),), ""))
    assert "here it is 0.1; install the same there" in unusable(((), "0.1"))


def blind(wanted: object) -> str:
    return "sees nothing"


def test_a_cluster_reduces_stretches_to_the_same_bits(whole, monkeypatch):
    """And is refused by the name of a worker that cannot."""
    distributed = pytest.importorskip("distributed", reason="needs the extra `cluster` (dask[distributed])")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0") as made:
        executor = start_workers(None, made.scheduler_address)
        try:
            found = reduced_on(executor, start(whole), whole)
            assert bits(found) == bits(reduced_on(InProcess(), start(whole), whole))
            monkeypatch.setattr(motion, "unusable", blind)
            with pytest.raises(InputError, match=r"scheduler \S+: worker \S+: sees nothing"):
                reduced_on(executor, start(whole), whole)
        finally:
            executor.close()
