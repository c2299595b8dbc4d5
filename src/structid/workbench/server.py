"""The workbench's server: a folder behind its guard, on this machine, until it is ended."""

from __future__ import annotations

import asyncio
import socket
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from threading import Event, Lock

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from structid.core.errors import InputError, StructidError
from structid.workbench.folder import ChangedError, OutsideError, opened
from structid.workbench.handlers import ROUTES, Handler, Workbench
from structid.workbench.recent import remember
from structid.workbench.runs import Runs, reap
from structid.workbench.security import Access, Guard
from structid.workbench.work.workers import Workers


class Workbenches:
    """Folders that are open on a port, each behind a token of its own; one opens others when its page asks for it."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.opened: dict[Access, Workbench] = {}
        self.ending = Event()
        self._opening = Lock()

    def open(self, folder: Path) -> Access:
        """How `folder` is reached, opened where it was not.

        Raises
        ------
        FileError
            If there is no such folder.
        """
        place = opened(folder)
        with self._opening:
            access = next((access for access, bench in self.opened.items() if bench.opened == place), None)
            if access is None:
                access = Access(self.port)
                bench = Workbench(place, access, Workers(str(place.root)), Runs(place), self.open, self.ending)
                self.opened[access] = bench
        remember(place.root)
        return access

    def close(self) -> None:
        """End what works for them."""
        for bench in list(self.opened.values()):
            bench.workers.close()


def application(benches: Workbenches) -> Guard:
    """What serves the folders that are open."""

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(_housekeeping(benches))
        yield
        task.cancel()
        benches.close()

    routes = [Route(path, _told(handler), methods=[method]) for method, path, handler in ROUTES]
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
    while True:
        await asyncio.sleep(5)
        for bench in list(benches.opened.values()):
            bench.workers.end_idle()
        reap()


def _told(handler: Handler) -> Callable[[Request], Awaitable[Response]]:
    """`handler` whose errors are words."""

    async def handled(request: Request) -> Response:
        bench: Workbench = request.scope["opened"]
        try:
            return await handler(bench, request)
        except ChangedError as error:
            return JSONResponse({"error": str(error)}, 409)
        except OutsideError as error:
            return JSONResponse({"error": str(error)}, 403)
        except StructidError as error:
            return JSONResponse({"error": str(error).replace(f"{bench.opened.root}/", "")}, 422)
        except (KeyError, TypeError, ValueError) as error:
            return JSONResponse({"error": f"the request cannot be used: {error}"}, 400)
        except OSError as error:
            words = f"{error.strerror or error}; check the disk and the permissions"
            return JSONResponse({"error": words}, 507 if error.errno == 28 else 500)

    return handled


def serve(folder: Path, port: int = 0, browser: bool = True) -> None:
    """Serve `folder` on this machine until it is interrupted.

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
            date_header=False,
            server_header=False,
        ),
    )
    print(f"structid workbench: {address}\n(this machine only; Ctrl-C ends it, runs go on)", flush=True)  # noqa: T201
    if browser:
        with suppress(webbrowser.Error):
            webbrowser.open(address)
    with suppress(KeyboardInterrupt):
        server.run(sockets=[taken])


def _socket(port: int) -> socket.socket:
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
