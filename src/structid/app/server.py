"""The workbench's server: a folder behind its guard, on this machine, until it is ended."""

from __future__ import annotations

import asyncio
import socket
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from structid.app.folder import ChangedError, OutsideError, opened
from structid.app.handlers import ROUTES, Handler, Workbench
from structid.app.recent import remember
from structid.app.runs import Runs, reap
from structid.app.security import Access, Guard
from structid.app.work.workers import Workers
from structid.errors import InputError, StructidError


def application(bench: Workbench) -> Guard:
    """What serves a folder."""

    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(_housekeeping(bench))
        yield
        task.cancel()
        bench.workers.close()

    routes = [Route(path, _told(bench, handler), methods=[method]) for method, path, handler in ROUTES]
    return Guard(Starlette(routes=routes, lifespan=life), bench.access)


class _Server(uvicorn.Server):
    """A server that lets every request come to its end before it ends."""

    def __init__(self, bench: Workbench, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.bench = bench

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self.bench.ending.set()
        self.bench.workers.close()
        await super().shutdown(sockets)


async def _housekeeping(bench: Workbench) -> None:
    while True:
        await asyncio.sleep(5)
        bench.workers.end_idle()
        reap()


def _told(bench: Workbench, handler: Handler) -> Callable[[Request], Awaitable[Response]]:
    """`handler` whose errors are words."""

    async def handled(request: Request) -> Response:
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
    access = Access(taken.getsockname()[1])
    place = opened(folder)
    bench = Workbench(place, access, Workers(str(place.root)), Runs(place))
    remember(folder.resolve())
    taken.listen(128)  # the page may ask before the server is up
    server = _Server(
        bench,
        uvicorn.Config(
            application(bench),
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=3,
            ws="none",
            date_header=False,
            server_header=False,
        ),
    )
    print(f"structid workbench: {access.address}\n(this machine only; Ctrl-C ends it, runs go on)", flush=True)  # noqa: T201
    if browser:
        with suppress(webbrowser.Error):
            webbrowser.open(access.address)
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
