"""Tasks on other processes and machines: the same bits as in this one, whoever is lost on the way."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import structid as sid
from structid import estimate
from structid.errors import InputError
from structid.estimation.intervals.bootstrap import bootstrap
from structid.estimation.intervals.profile import profiles
from structid.estimation.search.work import PLAIN_TOOLS, Tools
from structid.identification.search import shared_parts
from structid.study.run.checkpoint import Checkpoint
from structid.study.run.long_run import LongRun, executor_for
from structid.study.run.run import load_study, run_study, started, study_parts
from structid.study.work import cluster as tasks_cluster
from structid.study.work import parts as task_parts
from structid.study.work import tasks as tasks_module
from structid.study.work.cluster import Cluster
from structid.study.work.parts import StudyPlace, packed, unpacked
from structid.study.work.processes import Processes
from structid.study.work.spread import SpreadLines, spread
from structid.study.work.tasks import InProcess, WorkersLostError, in_batches, one_thread
from study_cases import CHAIN, chain_record, write_chain


def squared(shared: float, item: float, tools: Tools) -> float:
    return shared * item**2


def ending_once(shared: str, item: int, tools: Tools) -> int:
    """Ends its process the first time that item 3 comes."""
    if item == 3 and not Path(shared).exists():
        Path(shared).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item * item


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    record = chain_record()
    bent = record.values * (1 + 0.05 * np.sin(record.frequency))[:, None, None]
    text = CHAIN + "restarts = 2\nuniqueness_starts = 1\npole_free_start = false\n"
    return load_study(write_chain(tmp_path_factory.mktemp("tasks"), text, chain_record(values=bent)))


def place(study) -> StudyPlace:
    return StudyPlace(str(study.path.resolve()), tuple(sorted(study.digests.items())))


@pytest.fixture(scope="module")
def problem(study):
    return started(study).problems[0]


@pytest.fixture(scope="module")
def processes(study):
    pool = Processes(2, place(study))
    yield pool
    pool.close()


def test_a_package_names_what_workers_have_and_leaves_out_what_is_cached(study, problem):
    problem.linearize(problem.theta_start)
    whole = packed(problem)
    light = packed(problem, place(study), shared_parts([problem]))
    assert len(light.content) < 4000 < len(whole.content)
    for package in (whole, light):
        again = unpacked(package)
        assert "model" not in vars(again)
        assert np.array_equal(again.residual(again.theta_start), problem.residual(problem.theta_start))
        assert unpacked(package) is again


def test_a_worker_makes_the_same_parts(study, problem):
    structure, record = study_parts(study)
    assert np.array_equal(record.values, problem.record.values)
    assert structure.n_dofs == problem.structure.n_dofs


def test_packages_of_another_version_or_study_are_refused(study, problem):
    package = packed(problem)
    with pytest.raises(InputError, match=r"worker has structid .*, the tasks come from 0\.0"):
        unpacked(replace(package, version="0.0", digest="a"))
    other = StudyPlace(place(study).path, (("chain.toml", "0"),))
    with pytest.raises(InputError, match=r"chain\.toml is not the file that the tasks were made from"):
        unpacked(replace(packed(problem, other), digest="b"))


def test_results_come_in_the_order_of_the_items(processes):
    items = {number: float(number) for number in range(57)}
    for executor in (InProcess(), processes):
        found = dict(executor.completed(squared, 2.0, items, lambda _: Tools(None, None)))
        assert [found[number] for number in items] == [2.0 * number**2 for number in items]


def test_batches_grow_with_short_tasks_and_stay_single_with_long_ones():
    sizes: dict[float, list[int]] = {}
    with ThreadPoolExecutor(2) as pool:
        for seconds in (0.0001, 1.0):

            def ran(batch, seconds=seconds):
                return [(number, number) for number, _ in batch], seconds * len(batch)

            def submit(task, batch, seconds=seconds, ran=ran):
                sizes.setdefault(seconds, []).append(len(batch))
                return pool.submit(ran, batch)

            assert len(dict(in_batches(submit, 2, squared, dict.fromkeys(range(200))))) == 200
    assert max(sizes[0.0001]) > 20
    assert set(sizes[1.0]) == {1}


@pytest.mark.parametrize(("seconds", "most"), [(0.0001, 16), (0.01, 10), (1.0, 4)])
def test_so_many_messages_are_under_way_that_no_worker_waits(monkeypatch, seconds, most):
    """Short ones eight a worker, long ones two, where each is one task."""
    monkeypatch.setattr("structid.study.work.tasks.BATCH_SECONDS", 0.0)
    waiting: list[tuple[Future, tuple]] = []
    largest = 0

    def submit(task, batch):
        nonlocal largest
        future = Future()
        waiting.append((future, batch))
        largest = max(largest, len(waiting))
        return future

    def wait(pending, timeout, return_when):
        future, batch = waiting.pop(0)
        future.set_result(([(number, number) for number, _ in batch], seconds))
        return {future}, pending - {future}

    monkeypatch.setattr("structid.study.work.tasks.wait", wait)
    assert len(dict(in_batches(submit, 2, squared, dict.fromkeys(range(100))))) == 100
    assert largest == most


def test_threads_are_limited_in_libraries_that_come_later_too(monkeypatch):
    """The controller is kept for a second or until a module is loaded, and each use restores what was."""
    made = []

    class Controller:
        def __init__(self):
            made.append(self)

        def limit(self, limits):
            assert limits == 1
            return contextlib.nullcontext()

    monkeypatch.setattr("threadpoolctl.ThreadpoolController", Controller)
    tasks_module._pools.cache_clear()
    monkeypatch.setattr(tasks_module.time, "monotonic", lambda: 100.0)
    for _ in range(3):
        with one_thread():
            assert os.environ["STRUCTID_THREADS"] == "1"
    assert len(made) == 1
    monkeypatch.setitem(sys.modules, "a_new_one", sys)
    with one_thread():
        pass
    monkeypatch.setattr(tasks_module.time, "monotonic", lambda: 101.5)
    with one_thread():
        pass
    assert len(made) == 3
    tasks_module._pools.cache_clear()


def test_a_lost_process_is_replaced_and_its_tasks_are_redone(tmp_path, processes):
    items = {number: number for number in range(12)}
    found = dict(processes.completed(ending_once, str(tmp_path / "ended"), items, lambda _: Tools(None, None)))
    assert (tmp_path / "ended").exists()
    assert [found[number] for number in items] == [number**2 for number in items]


def test_processes_that_always_end_are_an_error_with_a_remedy(monkeypatch):
    """Six pools, each of which breaks at the first task."""
    made = []

    class Broken:
        def submit(self, *_):
            future = Future()
            future.set_exception(BrokenProcessPool())
            return future

    monkeypatch.setattr(Processes, "_started", lambda self: made.append(Broken()) or made[-1])
    pool = Processes(3)
    with pytest.raises(WorkersLostError, match=r"ended 6 times without an answer, .* want of memory; use fewer than 3"):
        list(pool.completed(squared, None, {0: 0}, lambda _: Tools(None, None)))
    assert len(made) == 6
    pool.close()


def test_a_study_on_processes_has_the_bits_of_one_alone(study, processes):
    """Restarts that run ahead, a uniqueness start, and what the checkpoint keeps of them."""
    alone = run_study(study).identification.estimate
    shared = run_study(study, None, LongRun(processes)).identification.estimate
    assert (alone.n_starts, alone.n_agreeing) == (shared.n_starts, shared.n_agreeing)
    assert alone.n_starts > 2
    for name in ("theta", "covariance", "history"):
        assert np.array_equal(getattr(alone, name), getattr(shared, name)), name


def test_profiles_on_processes_have_the_bits_of_those_alone(problem, processes):
    found = estimate(problem)
    work = LongRun(processes)
    work.known(shared_parts([problem]))
    for one, two in zip(profiles(problem, found, [0, 3]), profiles(problem, found, [0, 3], work=work), strict=True):
        assert np.array_equal(one.path, two.path)
        assert (one.lower, one.upper, one.words) == (two.lower, two.upper, two.words)


@pytest.fixture(scope="module")
def beam():
    """A cantilever of 40 elements, large enough to be factorized line by line: 23 lines, 5 sensors, 80 parameters."""
    element = sid.Beam("beam", [[i, i + 1] for i in range(40)], np.full(40, 0.1), np.full(40, 50.0))
    structure = sid.Structure({i: i / 40 for i in range(41)}, [element], ["0Y", "0RZ"])
    unknown = sid.parameters(structure, [sid.Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness")])
    values = np.random.default_rng(0).standard_normal((23, 5, 1)) * (1 + 0.2j)
    sensors = tuple(f"{node}Y+" for node in (8, 16, 24, 32, 40))
    record = sid.FrfRecord(np.linspace(0.5, 60, 23), values, sensors, ("40Y+",), "accelerance")
    return sid.FrfProblem(structure, unknown, record, model_error=0.1)


@pytest.mark.parametrize("n_workers", [2, 3, 40])
@pytest.mark.parametrize("form", ["output", "pole_free"])
def test_lines_in_stretches_have_the_bits_of_all_at_once(beam, form, n_workers):
    """Stretches of unequal length, down to one line each."""
    whole = replace(beam, form=form, parameters=beam.parameters.kept_near_start(0.5))
    executor = InProcess()
    executor.n_workers = n_workers
    parts = SpreadLines(whole, executor)
    theta = whole.theta_start + 0.01
    assert whole.model.is_large
    assert len(whole.linearize(theta).residual) == whole.n_data + 80
    assert np.array_equal(parts.linearize(theta).jacobian, whole.linearize(theta).jacobian)
    assert np.array_equal(parts.linearize(theta).residual, whole.linearize(theta).residual)
    assert np.array_equal(parts.residual(theta), whole.residual(theta))


def test_lines_are_spread_where_it_pays(beam, processes, monkeypatch):
    """Alone, and where a sweep is short, the problem stays as it is; the search on two processes has the same bits."""
    monkeypatch.setattr("structid.study.work.spread.WORTH_SENDING", 1000)
    assert spread(beam, InProcess()) is beam
    joint = sid.JointProblem((beam, beam))
    assert all(isinstance(member, SpreadLines) for member in spread(joint, processes).problems)
    near = replace(beam, record=replace(beam.record, values=1.05 * beam.predicted(beam.theta_start)))
    method = sid.LevenbergMarquardt(max_iterations=3)
    one, two = (LongRun(executor).minimize(near, method) for executor in (InProcess(), processes))
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.linearization.jacobian, two.linearization.jacobian)
    monkeypatch.setattr("structid.study.work.spread.WORTH_SENDING", 10**9)
    assert spread(beam, processes) is beam
    assert spread(joint, processes) is joint


def test_finished_tasks_are_not_run_again(tmp_path):
    """The checkpoint of a run with three tasks, resumed with five: two are run."""
    owner = {"layout": "structid checkpoint 1", "versions": {}, "inputs": {}}
    first = LongRun(checkpoint=Checkpoint(tmp_path / "c", owner, seconds=0.0))
    assert first.map("squares", squared, 1.0, [1.0, 2.0, 3.0]) == [1.0, 4.0, 9.0]
    told: list[tuple[str, int, int]] = []
    kept = Checkpoint(tmp_path / "c", owner, resume=True)
    second = LongRun(checkpoint=kept, progress=lambda *words: told.append(words))
    assert second.map("squares", squared, -1.0, [1.0, 2.0, 3.0, 4.0, 5.0]) == [1.0, 4.0, 9.0, -16.0, -25.0]
    assert told == [("squares", 3, 5), ("squares", 4, 5), ("squares", 5, 5)]
    assert second.map("squares", squared, 1.0, [6.0]) == [36.0]


def test_workers_and_scheduler_exclude_each_other(study):
    with pytest.raises(InputError, match="give --workers or --scheduler"):
        executor_for(study, 2, "tcp://127.0.0.1:1")
    with pytest.raises(InputError, match="`workers` must be at least 1, got 0"):
        executor_for(study, 0, None)


@pytest.fixture(scope="module")
def distributed():
    return pytest.importorskip("distributed", reason="needs the extra `cluster` (dask[distributed])")


@pytest.fixture(scope="module")
def cluster(distributed):
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as made:
        yield made


def test_a_cluster_that_loses_a_worker_has_the_bits_of_one_process(study, problem, cluster):
    """40 bootstrap replicates; a worker is killed when 15 are done."""
    found = estimate(problem)
    alone = bootstrap(problem, found, "noise", 40, np.random.default_rng(7), LongRun())
    executor = Cluster(cluster.scheduler_address, place(study))
    assert executor.n_workers == 2
    assert executor.place is not None
    victims = [worker.pid for worker in cluster.workers.values()]
    killed = []

    def progress(name: str, done: int, total: int) -> None:
        if done >= 15 and not killed:
            killed.append(victims[0])
            os.kill(victims[0], signal.SIGKILL)

    run = LongRun(executor, progress=progress)
    run.known(shared_parts([problem]))
    try:
        shared = bootstrap(problem, found, "noise", 40, np.random.default_rng(7), run)
    finally:
        run.close()
    assert killed
    assert len(alone.values) == 40
    assert np.array_equal(alone.values, shared.values)


def process_of(shared: object, item: float, tools: Tools) -> int:
    end = time.thread_time() + item
    while time.thread_time() < end:
        pass
    return os.getpid()


def forgotten(_: object) -> str:
    """A worker without what was given to it, as one that has just begun."""
    task_parts._GIVEN.clear()
    return ""


def entry(shared: np.ndarray, item: int, tools: Tools) -> float:
    return float(shared[item])


def test_what_is_large_is_on_all_workers_and_given_again_to_those_that_come(cluster, monkeypatch):
    """Tasks run on both workers for longer than Dask keeps copies of one result."""
    monkeypatch.setattr(tasks_cluster, "_SMALL_BYTES", 100)
    large = np.arange(100.0)
    executor = Cluster(cluster.scheduler_address)
    try:
        begun = time.monotonic()
        while time.monotonic() - begun < 4.5:
            found = dict(executor.completed(process_of, large, dict.fromkeys(range(4), 0.1), lambda _: PLAIN_TOOLS))
        assert len(set(found.values())) == 2
        other = 2 * large
        assert executor._sent(other).content == b""
        executor.asked(forgotten, None)
        found = dict(executor.completed(entry, other, {k: k for k in range(9)}, lambda _: PLAIN_TOOLS))
        assert [found[k] for k in range(9)] == [2 * k for k in range(9)]
    finally:
        executor.close()


def test_workers_that_never_keep_what_they_are_given_are_an_error(cluster, monkeypatch):
    monkeypatch.setattr(tasks_cluster, "_SMALL_BYTES", 100)
    monkeypatch.setattr(tasks_cluster, "given", forgotten)
    executor = Cluster(cluster.scheduler_address)
    try:
        with pytest.raises(WorkersLostError, match="come and go faster than they get the study"):
            list(executor.completed(entry, np.arange(50.0) + 0.5, {0: 0}, lambda _: PLAIN_TOOLS))
    finally:
        executor.close()


def test_a_package_that_was_not_given_is_missed():
    package = packed(np.arange(7.0))
    light = replace(package, content=b"")
    with pytest.raises(task_parts.PackageMissingError):
        unpacked(light)
    task_parts.given(package)
    assert unpacked(light)[3] == 3.0
    for number in range(9):
        task_parts.given(packed(np.array([float(number)])))
    assert len(task_parts._GIVEN) == 4


def test_workers_that_do_not_see_the_study_get_it_sent(study, problem, cluster):
    executor = Cluster(cluster.scheduler_address, StudyPlace("/nowhere/chain.toml", place(study).inputs))
    try:
        assert executor.place is None
        assert "which get the record sent (/nowhere/chain.toml: there is no such file" in executor.words
        run = LongRun(executor)
        run.known(shared_parts([problem]))
        found = run.map("squares", squared, 3.0, [1.0, 2.0])
        assert found == [3.0, 12.0]
    finally:
        executor.close()


def test_workers_of_another_version_are_named(cluster, monkeypatch):
    monkeypatch.setattr(tasks_cluster, "__version__", "99.0")
    with pytest.raises(InputError, match=r"worker tcp://\S+ has structid \S+, here it is 99\.0; install the same"):
        Cluster(cluster.scheduler_address)


def test_a_scheduler_that_does_not_answer_is_named_with_the_time(distributed):
    begun = time.monotonic()
    with pytest.raises(
        InputError, match=r"scheduler tcp://127\.0\.0\.1:9: does not answer within 0\.5 s .*dask scheduler"
    ):
        Cluster("tcp://127.0.0.1:9", answer_seconds=0.5)
    assert time.monotonic() - begun < 10


def test_what_listens_and_is_no_scheduler_is_named_and_not_waited_for(distributed, cluster):
    """A socket that says nothing, and a worker's address."""
    with socket.create_server(("127.0.0.1", 0)) as mute:
        begun, port = time.monotonic(), mute.getsockname()[1]
        with pytest.raises(
            InputError, match=r"does not answer within 0\.7 s \(it is there, but does not speak as one\)"
        ):
            Cluster(f"tcp://127.0.0.1:{port}", answer_seconds=0.7)
        assert time.monotonic() - begun < 10
    worker = next(iter(cluster.scheduler_info["workers"]))
    with pytest.raises(InputError, match="is a worker, not a scheduler; give the scheduler's address"):
        Cluster(worker, answer_seconds=5.0)
    with pytest.raises(InputError, match="missing port number"):
        Cluster("head")


def test_a_scheduler_that_lost_all_workers_is_left_with_the_way_to_go_on(monkeypatch):
    monkeypatch.setattr(tasks_cluster, "_GONE_SECONDS", 0.1)
    lost = object.__new__(Cluster)
    lost.address, lost._client = "tcp://head:8786", SimpleNamespace(status="running", nthreads=dict)
    with pytest.raises(WorkersLostError, match=r"has had no worker for 0\.1 s; what was done is kept: .* --resume"):
        lost._require_alive()
    lost._client.status = "connecting"
    with pytest.raises(WorkersLostError, match=r"the connection was lost; .* go on with --resume"):
        lost._require_alive()


def test_a_scheduler_without_workers_is_named(distributed):
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as empty,
        pytest.raises(InputError, match=r"has no worker after 0\.3 s; start some with `dask worker"),
    ):
        Cluster(empty.scheduler_address, answer_seconds=0.3)


def test_a_missing_dask_is_named_with_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"Dask is not installed .*pip install structid\[cluster\]"):
        Cluster("tcp://127.0.0.1:9")
