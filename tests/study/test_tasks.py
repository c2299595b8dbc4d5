"""Tasks on other processes and machines: the same bits as in this one, whoever is lost on the way."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_checkpoint import OWNER
from threadpoolctl import threadpool_info, threadpool_limits

import structid as sid
from structid import estimate
from structid.core.errors import InputError
from structid.inversion.intervals.bootstrap import bootstrap
from structid.inversion.intervals.profile import profiles
from structid.inversion.search.work import TaskContext
from structid.study.run import workers as workers_module
from structid.study.run.long_run import Checkpoint, LongRun, SpreadLines, spread, start_workers
from structid.study.run.piped import ProcessLostError
from structid.study.run.run import run_study
from structid.study.run.start import prepare_study
from structid.study.run.workers import InProcess, Processes, WorkersLostError, in_batches
from structid.study.schema.study import load_study
from study_cases import CHAIN, chain_record, write_chain


def squared(shared: float, item: float, tools: TaskContext) -> float:
    return shared * item**2


def ending_once(shared: str, item: int, tools: TaskContext) -> int:
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


@pytest.fixture(scope="module")
def problem(study):
    return prepare_study(study).problems[0]


@pytest.fixture(scope="module")
def processes():
    pool = Processes(2)
    yield pool
    pool.close()


def test_problems_travel_without_what_is_cached(problem):
    problem.linearize(problem.theta_start)
    again = pickle.loads(pickle.dumps(problem))
    assert "model" in vars(problem)
    assert "model" not in vars(again)
    assert np.array_equal(again.residual(again.theta_start), problem.residual(problem.theta_start))


def test_results_come_in_the_order_of_the_items(processes):
    items = {number: float(number) for number in range(57)}
    for executor in (InProcess(), processes):
        found = dict(executor.completed(squared, 2.0, items))
        assert [found[number] for number in items] == [2.0 * number**2 for number in items]


def test_batches_grow_with_short_tasks_and_stay_single_with_long_ones():
    sizes: dict[float, list[int]] = {}
    with ThreadPoolExecutor(2) as pool:
        for seconds in (0.0001, 1.0):

            def ran(batch, seconds=seconds):
                return [(number, number) for number, _ in batch], seconds * len(batch)

            def send(batch, seconds=seconds, ran=ran):
                sizes.setdefault(seconds, []).append(len(batch))
                return pool.submit(ran, batch)

            assert len(dict(in_batches(send, 2, dict.fromkeys(range(200))))) == 200
    assert max(sizes[0.0001]) > 20
    assert set(sizes[1.0]) == {1}


def test_as_many_batches_are_under_way_as_keep_all_workers_busy(monkeypatch):
    """Four a worker, each of one long task."""
    waiting: list[tuple[Future, list]] = []
    largest = 0

    def send(batch):
        nonlocal largest
        waiting.append((Future(), batch))
        largest = max(largest, len(waiting))
        return waiting[-1][0]

    def wait(pending, timeout, return_when):
        future, batch = waiting.pop(0)
        future.set_result(([(number, number) for number, _ in batch], 1.0))
        return {future}, pending - {future}

    monkeypatch.setattr(workers_module, "wait", wait)
    assert len(dict(in_batches(send, 2, dict.fromkeys(range(100))))) == 100
    assert largest == 8


def threads_now(shared: object, item: int, tools: TaskContext) -> list[object]:
    """Threads of every library that has some, and what factorizers are told."""
    return [os.environ["STRUCTID_THREADS"], *{pool["num_threads"] for pool in threadpool_info()}]


def test_every_task_runs_on_one_thread_and_leaves_this_process_as_it_was(processes, monkeypatch):
    monkeypatch.delenv("STRUCTID_THREADS", raising=False)
    with threadpool_limits(2):
        before = [pool["num_threads"] for pool in threadpool_info()]
        assert 2 in before
        for workers in (InProcess(), processes):
            assert list(dict(workers.completed(threads_now, None, dict.fromkeys(range(3)))).values()) == [["1", 1]] * 3
        assert [pool["num_threads"] for pool in threadpool_info()] == before
    assert "STRUCTID_THREADS" not in os.environ


def test_workers_are_given_the_same_object_once(processes, monkeypatch):
    """And forget the oldest of five."""
    given, forgotten = [], []
    give, forget = Processes.give, Processes.forget
    monkeypatch.setattr(Processes, "give", lambda self, content: given.append(give(self, content)) or given[-1])
    monkeypatch.setattr(Processes, "forget", lambda self, name: forgotten.append(name) or forget(self, name))
    shared = [np.full(3, float(k)) for k in range(5)]
    for k in (0, 1, 0, 1, 2, 3, 4, 1):
        assert dict(processes.completed(entry, shared[k], {0: 2})) == {0: float(k)}
    assert len(given) == 5
    assert given[0] in forgotten
    assert not set(given[1:]) & set(forgotten)


def test_a_lost_process_is_replaced_and_its_tasks_are_redone(tmp_path, processes):
    items = {number: number for number in range(12)}
    found = dict(processes.completed(ending_once, str(tmp_path / "ended"), items))
    assert (tmp_path / "ended").exists()
    assert [found[number] for number in items] == [number**2 for number in items]


def test_processes_that_always_end_are_an_error_with_a_remedy(monkeypatch):
    """Six pools, each of which breaks at the first task."""
    made = []

    class Broken:
        def submit(self, *_):
            future = Future()
            future.set_exception(ProcessLostError())
            return future

    monkeypatch.setattr(Processes, "executor", lambda self: made.append(Broken()) or made[-1])
    pool = Processes(3)
    with pytest.raises(WorkersLostError, match=r"ended 6 times without an answer, .* want of memory; use fewer than 3"):
        list(pool.completed(squared, None, {0: 0}))
    assert len(made) == 6
    pool.close()


def test_a_study_on_processes_has_the_bits_of_one_alone(study, processes):
    """Restarts that run ahead, a uniqueness start, and what the checkpoint keeps of them."""
    alone = run_study(study).identification.estimate
    shared = run_study(study, None, LongRun(processes)).identification.estimate
    assert (alone.search.n_starts, alone.search.n_agreeing) == (shared.search.n_starts, shared.search.n_agreeing)
    assert alone.search.n_starts > 2
    assert np.array_equal(alone.search.history, shared.search.history)
    for name in ("theta", "covariance"):
        assert np.array_equal(getattr(alone, name), getattr(shared, name)), name


def test_profiles_on_processes_have_the_bits_of_those_alone(problem, processes):
    found = estimate(problem)
    work = LongRun(processes)
    for one, two in zip(profiles(problem, found, [0, 3]), profiles(problem, found, [0, 3], work=work), strict=True):
        assert np.array_equal(one.values, two.values)
        assert np.array_equal(one.deviance, two.deviance)
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
    """Segments of unequal length, down to one line each."""
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
    monkeypatch.setattr("structid.study.run.long_run.WORTH_SENDING", 1000)
    assert spread(beam, InProcess()) is beam
    joint = sid.JointProblem((beam, beam))
    assert all(isinstance(member, SpreadLines) for member in spread(joint, processes).problems)
    near = replace(beam, record=replace(beam.record, values=1.05 * beam.predicted(beam.theta_start)))
    method = sid.LevenbergMarquardt(max_iterations=3)
    one, two = (LongRun(executor).minimize(near, method) for executor in (InProcess(), processes))
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.linearization.jacobian, two.linearization.jacobian)
    monkeypatch.setattr("structid.study.run.long_run.WORTH_SENDING", 10**9)
    assert spread(beam, processes) is beam
    assert spread(joint, processes) is joint


def test_finished_tasks_are_not_run_again(tmp_path):
    """The checkpoint of a run with three tasks, resumed with five: two are run."""
    first = LongRun(checkpoint=Checkpoint(tmp_path / "c", OWNER, seconds=0.0))
    assert first.map("squares", squared, 1.0, [1.0, 2.0, 3.0]) == [1.0, 4.0, 9.0]
    told: list[tuple[str, int, int]] = []
    kept = Checkpoint(tmp_path / "c", OWNER, resume=True)
    second = LongRun(checkpoint=kept, progress=lambda *words: told.append(words))
    assert second.map("squares", squared, -1.0, [1.0, 2.0, 3.0, 4.0, 5.0]) == [1.0, 4.0, 9.0, -16.0, -25.0]
    assert told == [("squares", 3, 5), ("squares", 4, 5), ("squares", 5, 5)]
    assert second.map("squares", squared, 1.0, [6.0]) == [36.0]


def test_workers_and_scheduler_exclude_each_other():
    with pytest.raises(InputError, match="give --workers or --scheduler"):
        start_workers(2, "tcp://127.0.0.1:1")
    with pytest.raises(InputError, match="`workers` must be at least 1, got 0"):
        start_workers(0, None)
    assert start_workers(None, None) is None
    assert isinstance(start_workers(1, None), InProcess)


@pytest.fixture(scope="module")
def distributed():
    return pytest.importorskip("distributed", reason="needs the extra `cluster` (dask[distributed])")


@pytest.fixture(scope="module")
def cluster_module(distributed):
    from structid.study.run import cluster

    return cluster


@pytest.fixture(scope="module")
def cluster(distributed):
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as made:
        yield made


def test_a_cluster_that_loses_a_worker_has_the_bits_of_one_process(problem, cluster, cluster_module):
    """40 bootstrap replicates; a worker is killed when 15 are done."""
    found = estimate(problem)
    alone = bootstrap(problem, found, "noise", 40, np.random.default_rng(7), LongRun())
    executor = cluster_module.Cluster(cluster.scheduler_address)
    assert executor.n_workers == 2
    victims = [worker.pid for worker in cluster.workers.values()]
    killed = []

    def progress(name: str, done: int, total: int) -> None:
        if done >= 15 and not killed:
            killed.append(victims[0])
            os.kill(victims[0], signal.SIGKILL)

    run = LongRun(executor, progress=progress)
    try:
        shared = bootstrap(problem, found, "noise", 40, np.random.default_rng(7), run)
    finally:
        run.close()
    assert killed
    assert len(alone.values) == 40
    assert np.array_equal(alone.values, shared.values)


def process_of(shared: object, item: float, tools: TaskContext) -> int:
    end = time.thread_time() + item
    while time.thread_time() < end:
        pass
    return os.getpid()


def entry(shared: np.ndarray, item: int, tools: TaskContext) -> float:
    return float(shared[item])


@pytest.mark.long
def test_what_is_shared_is_on_all_workers_and_on_those_that_come(cluster, cluster_module):
    """Tasks run on both workers for longer than Dask keeps copies of one result, then on three."""
    shared = np.arange(100_000.0)
    executor = cluster_module.Cluster(cluster.scheduler_address)
    try:
        begun, used = time.monotonic(), set()
        while time.monotonic() - begun < 4.5:
            used |= set(dict(executor.completed(process_of, shared, dict.fromkeys(range(4), 0.1))).values())
        assert len(used) == 2
        cluster.scale(3)
        executor._client.wait_for_workers(3, timeout=300)
        found = dict(executor.completed(process_of, shared, dict.fromkeys(range(30), 0.1)))
        assert len(set(found.values())) == 3
        assert dict(executor.completed(entry, shared, {k: k for k in range(9)})) == {k: float(k) for k in range(9)}
    finally:
        executor.close()


def plugins(dask_worker) -> list[str]:
    return [name for name in dask_worker.plugins if name.startswith("structid")]


def test_a_cluster_that_was_left_keeps_nothing(cluster, distributed, cluster_module):
    executor = cluster_module.Cluster(cluster.scheduler_address)
    assert dict(executor.completed(entry, np.arange(3.0), {0: 2})) == {0: 2.0}
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as other:
        assert {len(names) for names in other.run(plugins).values()} == {1}
        executor.close()
        assert {len(names) for names in other.run(plugins).values()} == {0}


@pytest.mark.parametrize(
    ("name", "version", "said"),
    [("structid", "99.0", "has structid 99.0, here it is"), ("scipy", None, "has no scipy; install scipy")],
)
def test_workers_of_another_version_are_named(cluster, distributed, cluster_module, monkeypatch, name, version, said):
    ask = distributed.Client.get_versions

    def told(client, **options):
        found = ask(client, **options)
        for worker in found["workers"].values():
            worker["packages"][name] = version
        return found

    monkeypatch.setattr(distributed.Client, "get_versions", told)
    with pytest.raises(InputError, match=rf"scheduler tcp://\S+: worker tcp://\S+ {said}"):
        cluster_module.Cluster(cluster.scheduler_address)


def test_a_scheduler_that_does_not_answer_is_named_with_the_time(cluster_module):
    begun = time.monotonic()
    with pytest.raises(
        InputError, match=r"scheduler tcp://127\.0\.0\.1:9: does not answer within 0\.5 s .*dask scheduler"
    ):
        cluster_module.Cluster("tcp://127.0.0.1:9", answer_seconds=0.5)
    assert time.monotonic() - begun < 120


def test_what_listens_and_is_no_scheduler_is_named_and_not_waited_for(cluster_module, cluster):
    """A socket that says nothing, and a worker's address."""
    with socket.create_server(("127.0.0.1", 0)) as mute:
        begun, port = time.monotonic(), mute.getsockname()[1]
        with pytest.raises(
            InputError, match=r"does not answer within 0\.7 s \(it is there, but does not speak as one\)"
        ):
            cluster_module.Cluster(f"tcp://127.0.0.1:{port}", answer_seconds=0.7)
        assert time.monotonic() - begun < 120
    worker = next(iter(cluster.scheduler_info["workers"]))
    with pytest.raises(InputError, match="is a worker, not a scheduler; give the scheduler's address"):
        cluster_module.Cluster(worker, answer_seconds=5.0)
    with pytest.raises(InputError, match="missing port number"):
        cluster_module.Cluster("head")


def test_a_scheduler_that_lost_all_workers_is_left_with_the_way_to_go_on(cluster_module, monkeypatch):
    monkeypatch.setattr(cluster_module, "_GONE_SECONDS", 0.1)
    lost = object.__new__(cluster_module.Cluster)
    lost.address, lost._client = "tcp://head:8786", SimpleNamespace(status="running", nthreads=dict)
    with pytest.raises(WorkersLostError, match=r"has had no worker for 0\.1 s; what was done is kept: .* --resume"):
        lost.require_alive()
    lost._client.status = "connecting"
    with pytest.raises(WorkersLostError, match=r"the connection was lost; .* go on with --resume"):
        lost.require_alive()


def test_a_scheduler_without_workers_is_named(distributed, cluster_module):
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as empty,
        pytest.raises(InputError, match=r"has no worker after 0\.3 s; start some with `dask worker"),
    ):
        cluster_module.Cluster(empty.scheduler_address, answer_seconds=0.3)


def test_a_missing_dask_is_named_with_the_extra(monkeypatch):
    monkeypatch.delitem(sys.modules, "structid.study.run.cluster", raising=False)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"Dask is not installed .*pip install structid\[cluster\]"):
        start_workers(None, "tcp://127.0.0.1:9")


ALONE_WITH_WORKERS = """
import os, sys, time
from structid.study.run.workers import Processes

def number(shared, item, tools):
    time.sleep(0.3)
    return os.getpid()

if __name__ == "__main__":
    workers = Processes(2)
    found = {pid for _, pid in workers.completed(number, None, dict(enumerate(range(4))))}
    print(*found, flush=True)
    time.sleep(600)
"""


def test_workers_of_a_killed_run_end_with_it(tmp_path):
    (tmp_path / "alone.py").write_text(ALONE_WITH_WORKERS)
    command = [sys.executable, str(tmp_path / "alone.py")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as run:
        workers = [int(word) for word in run.stdout.readline().split()]
        assert workers
        run.kill()
    give_up = time.monotonic() + 300
    while any(_is_running(worker) for worker in workers) and time.monotonic() < give_up:
        time.sleep(0.05)
    left = [worker for worker in workers if _is_running(worker)]
    for worker in left:
        os.kill(worker, signal.SIGKILL)
    assert left == []


def _is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
