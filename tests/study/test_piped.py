"""Processes on pipes: what they give and raise, and what comes of calls whose process ends."""

import os
import time
from concurrent.futures import CancelledError
from multiprocessing.connection import Connection

import psutil
import pytest

from structid.study.run.piped import PipedProcesses, ProcessLostError


@pytest.fixture
def one():
    made = PipedProcesses(1)
    yield made
    made.shutdown(wait=True)


def test_what_functions_give_raise_and_cannot_send(one):
    assert one.submit(divmod, 17, 5).result(60) == (3, 2)
    assert one.submit(int, "ff", base=16).result(60) == 255
    with pytest.raises(ValueError, match="invalid literal") as told:
        one.submit(int, "no number").result(60)
    assert "_answer" in told.value.__notes__[0]  # where it happened
    with pytest.raises(TypeError, match="cannot pickle"):
        one.submit(memoryview, b"what is no answer").result(60)
    assert one.submit(abs, -3).result(60) == 3


def test_a_process_that_ends_within_its_answer_is_lost_and_not_waited_for(one, monkeypatch):
    whole = Connection.recv
    number = one.submit(os.getpid).result(60)

    def ended_amid(pipe):
        assert pipe.poll(60)  # the beginning is here, and the rest does not fit into a pipe
        psutil.Process(number).kill()
        return whole(pipe)

    monkeypatch.setattr(Connection, "recv", ended_amid)
    with pytest.raises(ProcessLostError):
        one.submit(bytes, 50_000_000).result(60)


def test_calls_are_shared_by_processes_and_what_has_not_begun_is_cancelled(tmp_path):
    two = PipedProcesses(2)
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    numbers = {call.result(60) for call in [two.submit(_number_beside_another, tmp_path) for _ in range(6)]}
    assert len(numbers) == 2
    assert not numbers & before
    slow, late = [two.submit(_begun, tmp_path / f"begun {k}") for k in range(2)], two.submit(abs, -1)
    _wait_for_two(tmp_path, "begun *")
    two.shutdown(wait=True)
    for call in slow:
        with pytest.raises(ProcessLostError):
            call.result(60)
    with pytest.raises(CancelledError):
        late.result(60)
    assert not any(psutil.pid_exists(number) for number in numbers)


def _wait_for_two(folder, pattern):
    end = time.monotonic() + 300
    while len(list(folder.glob(pattern))) < 2:
        assert time.monotonic() < end
        time.sleep(0.01)


def _number_beside_another(folder):
    """The number of this process, once another one has a call too."""
    (folder / f"process {os.getpid()}").touch()
    _wait_for_two(folder, "process *")
    return os.getpid()


def _begun(path):
    path.touch()
    time.sleep(600)
