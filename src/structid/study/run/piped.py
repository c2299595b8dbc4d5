"""Processes of this machine that call functions, each on a pipe of its own, so that the end of one is seen at once.

A pool of `concurrent.futures` waits for ever for the rest of an answer whose process is gone: it holds the other end of
the pipe itself.
"""

from __future__ import annotations

import os
import signal
import threading
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from typing import ParamSpec, TypeVar

from structid.core.isolation import safe_child_environment

P = ParamSpec("P")
T = TypeVar("T")


class ProcessLostError(Exception):
    """A process ended before its answer was whole."""


class PipedProcesses(Executor):
    """Processes that begin when they are first needed, and take calls in the order in which these come.

    Parameters
    ----------
    n : int
        How many at most.
    begin : callable, optional
        A function of a module that each calls first.
    """

    def __init__(self, n: int, begin: Callable[[], None] | None = None) -> None:
        """A pool of `n` processes, each started when first needed; each calls `begin`, if given, before its first task."""
        self._threads = ThreadPoolExecutor(n)
        self._begin = begin
        self._guard = threading.Lock()
        self._pipes: dict[int, Connection] = {}
        self._processes: list[BaseProcess] = []
        self._is_ended = False

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Future of `fn` called in a process: its result, the exception that it raised, or `ProcessLostError`.

        Parameters
        ----------
        fn : callable
        *args, **kwargs
            What it takes; like its answer they are pickled.
        """
        return self._threads.submit(self._call_remote, fn, args, kwargs)

    def _call_remote(self, fn: Callable[..., T], arguments: tuple[object, ...], named: Mapping[str, object]) -> T:
        """Result of calling `fn` in the process that belongs to this thread, with the positional and keyword arguments passed.

        Raises `ProcessLostError` if that process ends, and the error of `fn` if it fails.
        """
        try:
            pipe = self._connection()
            pipe.send((fn, arguments, named))
            error: Exception | None
            answer: T
            error, answer = pipe.recv()
        except (EOFError, OSError) as gone:
            raise ProcessLostError("a process ended before its answer was whole") from gone
        if error is not None:
            raise error
        return answer

    def _connection(self) -> Connection:
        """The pipe to the process that belongs to this thread, started when first needed; `EOFError` after `shutdown`."""
        thread = threading.get_ident()
        with self._guard:
            if self._is_ended:
                raise EOFError
            if thread not in self._pipes:
                context = get_context("spawn")
                self._pipes[thread], theirs = context.Pipe()
                process = context.Process(target=_answer, args=(theirs, self._begin))
                with safe_child_environment():
                    process.start()
                theirs.close()
                self._processes.append(process)
            return self._pipes[thread]

    def shutdown(self, wait: bool = False, *, cancel_futures: bool = True) -> None:
        """End the processes at once, even in the middle of a call.

        Parameters
        ----------
        wait : bool, optional
            True to return only after they have ended.
        cancel_futures : bool, optional
            True to cancel calls that have not begun; else they fail.
        """
        with self._guard:
            self._is_ended = True
            for process in self._processes:
                process.terminate()
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for process in self._processes if wait else ():
            process.join()


def _answer(pipe: Connection, begin: Callable[[], None] | None) -> None:
    """Main loop of a child process: call the functions that arrive on `pipe`, and send back (error or None, result or None).

    `begin` is called first. The child ignores Ctrl-C, which the parent process handles, and ends with its parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()
    if begin is not None:
        begin()
    with suppress(EOFError, BrokenPipeError):  # nobody asks any more
        while True:
            function, arguments, named = pipe.recv()
            try:
                answer = ForkingPickler.dumps((None, function(*arguments, **named)))
            except Exception as error:  # for the one that asked
                error.add_note(traceback.format_exc())
                answer = ForkingPickler.dumps((error, None))
            pipe.send_bytes(answer)


def _end_after(parent: BaseProcess) -> None:
    """Wait for the process `parent` to end in any way, then end this process."""
    parent.join()
    os._exit(1)
