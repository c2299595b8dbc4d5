"""What the page asks for: each address, answered from files, runs and worker processes."""

from __future__ import annotations

import asyncio
import json
import tempfile
import zipfile
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from threading import Event
from typing import Any
from urllib.parse import quote

from starlette.background import BackgroundTask
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse

from structid._version import __version__
from structid.core.errors import FileError, InputError
from structid.files import atomic_write
from structid.study.templates import TEMPLATES, asked_of
from structid.workbench.edits import edited
from structid.workbench.folder import ChangedError, OpenFolder, digest, read_json, typed_folder, upload_name
from structid.workbench.recent import recent_folders
from structid.workbench.runs import Runs
from structid.workbench.security import MOST_UPLOAD, Access
from structid.workbench.studies import reading_keys, study_answer
from structid.workbench.work.workers import Workers

_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_SEEN = {".html", ".json", ".toml", ".csv", ".h5", ".uff", ".png", ".txt"}
_TICK = 0.5
_SIDE_BY_SIDE = 60


@dataclass(frozen=True)
class Workbench:
    """All that the handlers share about a folder.

    Attributes
    ----------
    opened : OpenFolder
    access : Access
        By which it, and it alone, is reached.
    workers : Workers
    runs : Runs
    open : callable
        Opens another folder, or finds it open, and gives its access.
    ending : Event
        Set when the server ends.
    """

    opened: OpenFolder
    access: Access
    workers: Workers
    runs: Runs
    open: Callable[[Path], Access]
    ending: Event

    def version(self, study: str) -> str:
        """What changes when a study or one of the files beside it does."""
        path = self.opened.inside(study)
        stamps = [f"{p.name}{p.stat().st_mtime_ns}" for p in sorted(path.parent.iterdir()) if p.is_file()]
        return digest("|".join(stamps).encode()) if path.exists() else ""

    def shown(self, page: str) -> str:
        """The address under which a page of results is seen."""
        return f"/view/{self.access.view_key(page)}/{quote(page)}"

    async def worked(self, name: str, given: dict[str, Any], version: str = "") -> Response:
        """The answer of a worker."""
        return _answered(await self.workers(name, given, version))


def _answered(answer: str) -> Response:
    """What a worker gave."""
    return Response(answer, 422 if answer.startswith('{"error"') else 200, media_type="application/json")


Handler = Callable[[Workbench, Request], Awaitable[Response]]


async def _index(_: Workbench, __: Request) -> Response:
    return _static("index.html")


async def _file(_: Workbench, request: Request) -> Response:
    return _static(request.path_params["name"])


async def _step(_: Workbench, request: Request) -> Response:
    return _static(request.path_params["name"], "steps")


def _static(name: str, folder: str = "") -> Response:
    """A file of the page; names have no slash, so that none leads elsewhere."""
    own = files("structid.workbench") / "static" / folder / name
    path = files("structid.report") / "plotly_parts" / "plotly-cartesian.min.js" if name == "plotly.js" else own
    if not path.is_file() or Path(name).suffix not in _TYPES:
        return PlainTextResponse("There is no such file.", 404)
    kept = "private, max-age=3600" if name == "plotly.js" else "no-cache"
    kind = f"{_TYPES[Path(name).suffix]}; charset=utf-8"
    return FileResponse(str(path), media_type=kind, headers={"cache-control": kept})


async def _folder(bench: Workbench, _: Request) -> Response:
    _later(bench.workers.warm())
    found = await asyncio.to_thread(bench.opened.listing)
    recent = [one for one in await asyncio.to_thread(recent_folders) if one != str(bench.opened.root)]
    told = {"recent": recent, "reading": reading_keys(), "version": __version__, "runs": bench.runs.summaries()}
    return JSONResponse({**found, **told})


async def _open(bench: Workbench, request: Request) -> Response:
    """Another folder, which has an address of its own from then on."""
    path = typed_folder(str((await request.json())["folder"]))
    return JSONResponse({"address": f"/{(await asyncio.to_thread(bench.open, path)).token}/"})


async def _templates(_: Workbench, __: Request) -> Response:
    return JSONResponse(
        [
            {"name": name, "words": kind.words, "asks": [vars(one) for one in asked_of(kind)]}
            for name, kind in TEMPLATES.items()
        ]
    )


async def _init(bench: Workbench, request: Request) -> Response:
    given = await request.json()
    bench.opened.inside(given["path"])
    return await bench.worked("init", {key: given[key] for key in ("template", "path", "numbers")})


async def _study(bench: Workbench, request: Request) -> Response:
    text, mark = bench.opened.text(request.query_params["study"])
    return JSONResponse(study_answer(text, mark))


async def _line(bench: Workbench, request: Request) -> Response:
    study = request.query_params["study"]
    return await bench.worked("line", {"study": study}, bench.version(study))


async def _save(bench: Workbench, request: Request) -> Response:
    given = await request.json()
    return JSONResponse(study_answer(given["text"], bench.opened.save(given["study"], given["text"], given["digest"])))


async def _edit(bench: Workbench, request: Request) -> Response:
    given = await request.json()
    text, mark = bench.opened.text(given["study"])
    if mark != given["digest"]:
        raise ChangedError(f"{given['study']}: was changed by another page or program; what it says now is shown")
    changed = edited(text, given["edits"])
    return JSONResponse(study_answer(changed, bench.opened.save(given["study"], changed, mark)))


def _of_study(name: str, **numbers: int) -> Handler:
    """A question to a worker about a study, with whole numbers that have defaults."""

    async def asked(bench: Workbench, request: Request) -> Response:
        study = request.query_params["study"]
        own = {key: int(request.query_params.get(key, default)) for key, default in numbers.items()}
        given: dict[str, Any] = {"study": study, **own}
        return await bench.worked(name, given, bench.version(study))

    return asked


def _of_body(name: str, *keys: str) -> Handler:
    """A question to a worker with what it needs in the body."""

    async def asked(bench: Workbench, request: Request) -> Response:
        body = await request.json()
        return await bench.worked(name, {key: body[key] for key in keys})

    return asked


async def _facts(bench: Workbench, request: Request) -> Response:
    """What a file is understood as: found out once, until it changes."""
    body = await request.json()
    path = bench.opened.inside(body["record"])
    stamp = path.stat() if path.is_file() else None
    version = f"{stamp.st_mtime_ns} {stamp.st_size}" if stamp else ""
    return await bench.worked("facts", {key: body[key] for key in ("record", "options")}, version)


def _modes_folder(name: str, *keys: str) -> Handler:
    """A question to a worker that writes a folder of modes, with the address of its page."""

    async def asked(bench: Workbench, request: Request) -> Response:
        body = await request.json()
        if bench.opened.inside(body["out"]).exists() and not body.get("replace"):
            raise ChangedError(f"{body['out']}: is there already; give another folder, or replace what is in it")
        found = json.loads(await bench.workers(name, {key: body[key] for key in keys}))
        page = f"{body['out']}/report.html"
        shown = bench.shown(page) if bench.opened.inside(page).is_file() else ""
        return JSONResponse({**found, "page": shown}, 422 if "error" in found else 200)

    return asked


async def _histories(bench: Workbench, request: Request) -> Response:
    body = await request.json()
    given = {key: body[key] for key in ("record", "options", "first", "last", "points")}
    answer = await bench.workers("histories", given)
    if '"sampled":true' in answer and bench.opened.is_writable:
        part = {"record": body["record"], "options": body["options"]}
        _later(bench.workers("overview", part))
    return _answered(answer)


_tasks: set[asyncio.Task[Any]] = set()


def _later(work: Any) -> None:
    task = asyncio.ensure_future(work)
    _tasks.add(task)
    task.add_done_callback(_tasks.discard)


async def _upload(bench: Workbench, request: Request) -> Response:
    name = upload_name(request.query_params["name"])
    path = bench.opened.inside(name)
    if path.exists() and request.query_params.get("replace") != "yes":
        raise InputError(f"{name}: is there already; rename the new file, or remove the old one")
    taken = 0
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        try:
            async for chunk in request.stream():
                taken += len(chunk)
                if taken > MOST_UPLOAD:
                    raise InputError(
                        f"{name}: is larger than {MOST_UPLOAD // 1_000_000_000} GB; copy it into the folder"
                    )
                await asyncio.to_thread(stream.write, chunk)
        except ClientDisconnect as error:
            raise FileError(f"{name}: did not arrive whole; nothing was kept, drop it again") from error
        if not taken:
            raise InputError(f"{name}: is empty")
    return JSONResponse({"path": name})


async def _start_run(bench: Workbench, request: Request) -> Response:
    given = await request.json()
    run = await asyncio.to_thread(bench.runs.start, given["study"], given["results"], bool(given.get("resume")))
    return JSONResponse(run.summary())


async def _run(bench: Workbench, request: Request) -> Response:
    return JSONResponse(bench.runs[request.path_params["id"]].progress(int(request.query_params.get("after", 0))))


async def _act(bench: Workbench, request: Request) -> Response:
    run, action = bench.runs[request.path_params["id"]], request.path_params["action"]
    if action == "stop":
        run.stop()
    elif action in ("pause", "continue"):
        run.pause(action == "pause")
    else:
        raise InputError(f"a run can stop, pause and continue, not {action}")
    return JSONResponse(run.summary())


async def _events(bench: Workbench, request: Request) -> Response:
    """What has changed, as long as page and server are there: states of runs, and stamps of studies."""

    async def changes() -> AsyncIterator[str]:
        before, ticks = "", 0
        while not (bench.ending.is_set() or await request.is_disconnected()):
            now = json.dumps(await asyncio.to_thread(_state, bench))
            ticks += 1
            if now != before:
                before = now
                yield f"data: {now}\n\n"
            elif ticks % 30 == 0:
                yield ": still here\n\n"
            await asyncio.sleep(_TICK)

    return StreamingResponse(changes(), media_type="text/event-stream", headers={"x-accel-buffering": "no"})


def _state(bench: Workbench) -> dict[str, Any]:
    return {"runs": bench.runs.summaries()[:_SIDE_BY_SIDE], "studies": bench.opened.stamps()}


async def _results(bench: Workbench, request: Request) -> Response:
    name = request.query_params["results"]
    folder = bench.opened.inside(name)
    found = read_json(folder / "estimate.json")
    if not isinstance(found, dict):
        raise FileError(f"{name}: holds no results; run the study first")
    kept = [p for p in sorted(folder.rglob("*")) if p.is_file() and p.suffix in _SEEN and not p.name.startswith(".")]
    listed = [{"path": bench.opened.name(p), "bytes": p.stat().st_size} for p in kept[:200]]
    page = f"{name}/report.html"
    shown = bench.shown(page) if (folder / "report.html").is_file() else ""
    keys = (
        "title",
        "status",
        "status_text",
        "verdict",
        "verdict_text",
        "verdict_reasons",
        "causes",
        "suggestions",
        "parameters",
        "total_mass",
        "modes",
        "warnings",
        "chi_square_per_dof",
    )
    return JSONResponse({"results": {key: found.get(key) for key in keys}, "files": listed, "report": shown})


async def _view(bench: Workbench, request: Request) -> Response:
    path = bench.opened.inside(request.path_params["name"])
    if path.suffix != ".html" or not path.is_file():
        return PlainTextResponse("There is no such page.", 404)
    return FileResponse(path, media_type="text/html; charset=utf-8")


async def _download(bench: Workbench, request: Request) -> Response:
    path = bench.opened.inside(request.query_params["path"])
    if not path.is_file() or path.suffix not in _SEEN:
        raise FileError(f"{request.query_params['path']}: is not there any more")
    return FileResponse(path, filename=path.name, media_type="application/octet-stream")


async def _export(bench: Workbench, request: Request) -> Response:
    """A folder of results as one archive."""
    folder = bench.opened.inside(request.query_params["results"])
    if not (folder / "estimate.json").is_file():
        raise FileError(f"{request.query_params['results']}: holds no results")
    with tempfile.NamedTemporaryFile(suffix=".zip", delete=False) as made:
        target = Path(made.name)
    await asyncio.to_thread(_archive, folder, target)
    return FileResponse(
        target, filename=f"{folder.name}.zip", media_type="application/zip", background=BackgroundTask(target.unlink)
    )


def _archive(folder: Path, target: Path) -> None:
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.is_symlink() and not path.name.startswith("."):
                archive.write(path, f"{folder.name}/{path.relative_to(folder).as_posix()}")


#: Method, path and handler of every address.
ROUTES: tuple[tuple[str, str, Handler], ...] = (
    ("GET", "/", _index),
    ("GET", "/static/{name}", _file),
    ("GET", "/static/steps/{name}", _step),
    ("GET", "/view/{name:path}", _view),
    ("GET", "/api/folder", _folder),
    ("POST", "/api/open", _open),
    ("GET", "/api/templates", _templates),
    ("POST", "/api/init", _init),
    ("PUT", "/api/file", _upload),
    ("GET", "/api/study", _study),
    ("POST", "/api/study", _save),
    ("POST", "/api/edit", _edit),
    ("GET", "/api/line", _line),
    ("GET", "/api/scene", _of_study("scene", number=0)),
    ("GET", "/api/channels", _of_study("channels", number=0)),
    ("GET", "/api/check", _of_study("check")),
    ("GET", "/api/needs", _of_study("needs")),
    ("GET", "/api/plan", _of_study("plan", sensors=4)),
    ("POST", "/api/mesh", _of_body("mesh", "path", "length_unit")),
    ("POST", "/api/facts", _facts),
    ("POST", "/api/histories", _histories),
    ("POST", "/api/responses", _of_body("responses", "study", "outputs", "number")),
    ("POST", "/api/survey", _of_body("survey", "record", "options", "band")),
    ("POST", "/api/pick", _modes_folder("pick", "record", "options", "frequencies", "out", "band")),
    ("POST", "/api/merge", _modes_folder("merge", "records", "options", "out", "band")),
    ("POST", "/api/beside", _of_body("beside", "study", "number", "measured", "at")),
    ("POST", "/api/runs", _start_run),
    ("GET", "/api/runs/{id}", _run),
    ("POST", "/api/runs/{id}/{action}", _act),
    ("GET", "/api/events", _events),
    ("GET", "/api/results", _results),
    ("GET", "/api/download", _download),
    ("GET", "/api/export", _export),
)
