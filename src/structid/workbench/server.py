"""The workbench's server: a folder behind its guard, on this machine, until it is ended."""

from __future__ import annotations

import asyncio
import os
import secrets
import socket
import stat
import sys
import tempfile
import time
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from threading import Event, Lock, Timer
from typing import TextIO

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from structid.core.errors import InputError, StructidError
from structid.workbench.folder import ChangedError, OutsideError, open_study_folder
from structid.workbench.handlers import ROUTES, Handler, Json, Watcher, Workbench
from structid.workbench.runs import Runs, reap
from structid.workbench.security import Access, DeadlineProtocol, Guard
from structid.workbench.user_state import remember, state_folder, write_private
from structid.workbench.work.workers import Workers

#: Connections at most, and seconds after which the page that leads a browser to an ended server is removed.
_MOST_CONNECTIONS, _REDIRECT_SECONDS = 256, 24 * 3600.0
#: Seconds in which a browser opens that page.
_OPENING_SECONDS = 60.0


class Workbenches:
    """Folders that are open on a port, each behind a token of its own; one opens others when its page asks for it."""

    def __init__(self, port: int) -> None:
        """No open folders yet, for a server at `port` of this machine."""
        self.port = port
        self.opened: dict[Access, Workbench] = {}
        self.ending = Event()
        self._opening = Lock()

    def open(self, folder: Path) -> Access:
        """Access to `folder`, with its address and token; a folder that is open already keeps its access.

        The folder is remembered among the user's recent ones.

        Raises
        ------
        FileError
            If there is no such folder, or it cannot be read.
        """
        opened = open_study_folder(folder)
        with self._opening:
            access = next((access for access, bench in self.opened.items() if bench.opened == opened), None)
            if access is None:
                access = Access(self.port)
                runs = Runs(opened)
                workers, watcher = Workers(str(opened.root)), Watcher(opened, runs)
                bench = Workbench(opened, access, workers, runs, self.open, self.ending, watcher)
                self.opened[access] = bench
        remember(opened.root)
        return access

    def close(self) -> None:
        """End the worker processes of all open folders."""
        for bench in list(self.opened.values()):
            bench.workers.close()


def application(benches: Workbenches) -> Guard:
    """ASGI application that serves all folders of `benches`, behind checks of port and token."""

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        """Context of the server's life: housekeeping runs inside, and all folders are closed at the end."""
        task = asyncio.create_task(_housekeeping(benches))
        yield
        task.cancel()
        benches.close()

    routes = [Route(path, _with_json_errors(handler), methods=[method]) for method, path, handler in ROUTES]
    return Guard(Starlette(routes=routes, lifespan=life), benches.port, benches.opened)


class _Server(uvicorn.Server):
    """A server that lets every request come to its end before it ends."""

    def __init__(self, benches: Workbenches, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.benches = benches

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self.benches.ending.set()
        self.benches.close()
        await super().shutdown(sockets)


async def _housekeeping(benches: Workbenches) -> None:
    """End idle workers and collect ended runs every five seconds, until cancelled."""
    while True:
        await asyncio.sleep(5)
        for bench in list(benches.opened.values()):
            bench.workers.end_idle()
        reap()


def _with_json_errors(handler: Handler) -> Callable[[Request], Awaitable[Response]]:
    """Request handler that answers errors of `handler` as JSON ``{"error": message}`` with an HTTP status.

    409 for a changed file, 403 for a path outside the folder, 422 for other errors of structid, 400 for a wrong request, 507
    for a full disk and 500 for other errors of the system.
    """

    async def handled(request: Request) -> Response:
        """Response of `handler` for the workbench in the request's scope, or its error as JSON ``{"error": message}``.

        The HTTP status is 409 for a changed file, 403 for a path outside the folder, 422 for other errors of structid,
        400 for a wrong request, 507 for a full disk and 500 for other errors of the system.
        """
        bench: Workbench = request.scope["opened"]
        try:
            return await handler(bench, request)
        except ChangedError as error:
            return Json({"error": str(error)}, 409)
        except OutsideError as error:
            return Json({"error": str(error)}, 403)
        except StructidError as error:
            return Json({"error": str(error).replace(f"{bench.opened.root}/", "")}, 422)
        except (KeyError, TypeError, ValueError) as error:
            return Json({"error": f"the request cannot be used: {error}"}, 400)
        except OSError as error:
            words = f"{error.strerror or error}; check the disk and the permissions"
            return Json({"error": words}, 507 if error.errno == 28 else 500)

    return handled


def serve(folder: Path, port: int = 0, browser: bool = True) -> None:
    """Serve `folder` on this machine until interrupted, print its address, and open it in a browser if `browser`.

    `port` 0 takes any free port. Where other users may read the output, a private file that leads to the address is
    named instead of it.

    Raises
    ------
    FileError
        If there is no such folder.
    InputError
        If the port is taken.
    """
    taken = _socket(port)
    benches = Workbenches(taken.getsockname()[1])
    address = benches.open(folder).address
    taken.listen(128)  # the page may ask before the server is up
    server = _Server(
        benches,
        uvicorn.Config(
            application(benches),
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=3,
            ws="none",
            http=DeadlineProtocol,
            limit_concurrency=_MOST_CONNECTIONS,
            date_header=False,
            server_header=False,
        ),
    )
    page = _redirect_page(address)
    try:
        shown = page.as_uri() if _is_read_by_others(sys.stdout) else address
        if shown == address:
            forget = Timer(_OPENING_SECONDS, lambda: page.unlink(missing_ok=True))
            forget.daemon = True
            forget.start()
        print(f"structid workbench: {shown}\n(this machine only; Ctrl-C ends it, runs go on)", flush=True)  # noqa: T201
        if browser:
            with suppress(webbrowser.Error):
                webbrowser.open(page.as_uri())  # the command line of a browser is seen by every user of the machine
        with suppress(KeyboardInterrupt):
            server.run(sockets=[taken])
    finally:
        page.unlink(missing_ok=True)


def _redirect_page(address: str) -> Path:
    """Path of a new private HTML file that leads a browser to `address`.

    It keeps the address, which holds a secret, off the browser's command line. Such files older than a day are removed.
    """
    text = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
        f'<meta http-equiv="refresh" content="0; url={address}"><title>structid workbench</title></head>'
        f'<body><p><a href="{address}">Open the workbench</a></p></body></html>\n'
    )
    name = f"open-{secrets.token_hex(8)}.html"
    try:
        # browsers that are snaps read no hidden folder of the home folder
        folder = Path.home() if (Path.home() / "snap").is_dir() else state_folder()
        name = f"structid-{name}" if folder == Path.home() else name
        for left in state_folder().glob(f"open-{'[0-9a-f]' * 16}.html"):  # of servers that were killed
            if time.time() - left.stat().st_mtime > _REDIRECT_SECONDS:
                left.unlink(missing_ok=True)
        write_private(folder / name, text)
    except (OSError, RuntimeError):  # no home folder, or one that cannot be written
        folder = Path(tempfile.mkdtemp(prefix="structid-"))
        write_private(folder / name, text)
    return folder / name


def _is_read_by_others(stream: TextIO) -> bool:
    """True if `stream` is a file whose permissions let other users read it; False on Windows."""
    with suppress(OSError, ValueError):
        mode = os.fstat(stream.fileno()).st_mode
        return os.name == "posix" and stat.S_ISREG(mode) and bool(mode & 0o044)
    return False


def _socket(port: int) -> socket.socket:
    """Socket bound to `port` of 127.0.0.1, or to any free port for 0; raises `InputError` if the port is taken."""
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind(("127.0.0.1", port))
    except OSError as error:
        made.close()
        raise InputError(
            f"port {port} cannot be taken ({error.strerror}); give another one with --port, or leave it out for any"
        ) from error
    return made
