"""Handlers of the page's addresses, answered from files, runs and worker processes."""

from __future__ import annotations

import asyncio
import datetime
import json
import math
import os
import re
import tempfile
import zipfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import islice
from pathlib import Path
from threading import Event
from typing import Any
from urllib.parse import quote

from starlette.background import BackgroundTask
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse

from structid._version import __version__
from structid.core.errors import FileError, InputError
from structid.files import atomic_write, claim_path, read_start
from structid.records.formats import ReadOptions
from structid.study.schema.edits import edited
from structid.study.schema.tables import Table, table_of
from structid.study.schema.toml_lines import parse_toml
from structid.study.templates import TEMPLATES, asked_of
from structid.workbench.folder import EXPORTS, ChangedError, OpenFolder, digest, read_json, typed_folder, upload_name
from structid.workbench.runs import Runs
from structid.workbench.sections import element_properties, presets
from structid.workbench.security import MOST_UPLOAD, Access
from structid.workbench.user_state import is_confirmed, recent_folders, remember_confirmed
from structid.workbench.work.workers import Workers

_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_SEEN = {".html", ".json", ".toml", ".csv", ".h5", ".uff", ".png", ".txt"}
#: Files for other programs, in the folder beside results.
_EXPORTED = _SEEN | {
    ".bdf", ".dat", ".fem", ".inp", ".mat", ".mtx", ".nas", ".npy", ".npz", ".op4", ".pch", ".pun", ".uf", ".unv", ".vtu"
}  # fmt: skip
_TICK = 0.5
#: Pages that hear of changes, files of results that are told, and files beside a study that are looked at, at most.
_MOST_STREAMS, _MOST_RESULTS, _MOST_STAMPS = 64, 2000, 10_000
#: Lines of a table that are shown while its layout is chosen, letters of each, and bytes that are read for them.
_PREVIEW_LINES, _PREVIEW_LETTERS, _PREVIEW_BYTES = 12, 400, 20_000
#: Files that are being uploaded.
_arriving: set[Path] = set()
#: Work that goes on after an answer.
_tasks: set[asyncio.Task[Any]] = set()
#: Tables that the page does not look at are left out where the text is longer.
_LONG = 3_000_000


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
    watcher : Watcher
    """

    opened: OpenFolder
    access: Access
    workers: Workers
    runs: Runs
    open: Callable[[Path], Access]
    ending: Event
    watcher: Watcher

    def version(self, study: str) -> str:
        """Digest of names, modification times and sizes of the files that stand with `study`; "" if `study` is missing.

        These are the files of the folder that holds it, 10 000 at most. The digest changes whenever one of them does,
        and so serves as a cache key. `study` is the path of a file or folder in the open folder; `OutsideError` if it
        leads out of that.
        """
        path = self.opened.inside(study)
        stamps = []
        with suppress(OSError), os.scandir(path.parent) as scan:
            for entry in islice(scan, _MOST_STAMPS):
                with suppress(OSError):
                    stat = entry.stat()
                    stamps.append(os.fsencode(entry.name) + f" {stat.st_mtime_ns} {stat.st_size}".encode())
        return digest(b"|".join(sorted(stamps))) if path.exists() else ""

    def shown(self, page: str) -> str:
        """Path of the address under which the report `page`, a file in the open folder, is shown."""
        return f"/view/{self.access.view_key(page)}/{quote(page)}"

    async def worked(self, name: str, arguments: dict[str, Any], version: str = "") -> Response:
        """Response with the answer of the worker function `name` to `arguments`; cached if `version` is not ""."""
        return _answered(await self.workers(name, arguments, version))


class Json(JSONResponse):
    """An answer in ASCII: names and texts of files may hold what is no text."""

    def render(self, content: Any) -> bytes:
        """The bytes of `content`."""
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode("ascii")


def _answered(answer: str) -> Response:
    """Response with the JSON answer of a worker; status 422 where it is an error."""
    return Response(answer, 422 if answer.startswith('{"error"') else 200, media_type="application/json")


Handler = Callable[[Workbench, Request], Awaitable[Response]]


async def _index(_: Workbench, __: Request) -> Response:
    return _static("index.html")


async def _file(_: Workbench, request: Request) -> Response:
    return _static(request.path_params["name"])


async def _step(_: Workbench, request: Request) -> Response:
    return _static(request.path_params["name"], "steps")


async def _editor(_: Workbench, request: Request) -> Response:
    return _static(request.path_params["name"], "editor")


def _static(name: str, folder: str = "") -> Response:
    """Response with the file `name` of the web page, from the subfolder `folder` of its static files; 404 if there is none.

    "plotly.js" is the plotting library, which the browser may keep for an hour.
    """
    file = files("structid.workbench") / "static" / folder / name
    path = files("structid.report") / "plotly_parts" / "plotly-cartesian.min.js" if name == "plotly.js" else file
    if not path.is_file() or Path(name).suffix not in _TYPES:
        return PlainTextResponse("There is no such file.", 404)
    kept = "private, max-age=3600" if name == "plotly.js" else "no-cache"
    kind = f"{_TYPES[Path(name).suffix]}; charset=utf-8"
    return FileResponse(str(path), media_type=kind, headers={"cache-control": kept})


async def _folder(bench: Workbench, _: Request) -> Response:
    """Answer with the listing of the open folder, recent folders, reading options, version and runs.

    Worker processes are started in the background.
    """
    _later(bench.workers.warm())
    listing = await asyncio.to_thread(bench.opened.listing)
    recent = [one for one in await asyncio.to_thread(recent_folders) if one != str(bench.opened.root)]
    facts = {"recent": recent, "reading": reading_keys(), "version": __version__, "runs": bench.runs.summaries()}
    return Json({**listing, **facts})


async def _open(bench: Workbench, request: Request) -> Response:
    """Open another folder, which gets its own address, and answer with that as ``address``.

    The body has ``folder``, its path as typed by the user. `InputError` if that is no whole path, `FileError` if there
    is no such folder.
    """
    path = typed_folder(str((await request.json())["folder"]))
    return Json({"address": f"/{(await asyncio.to_thread(bench.open, path)).token}/"})


async def _templates(_: Workbench, __: Request) -> Response:
    return Json(
        [
            {"name": name, "words": kind.words, "asks": [vars(one) for one in asked_of(kind)]}
            for name, kind in TEMPLATES.items()
        ]
    )


async def _init(bench: Workbench, request: Request) -> Response:
    """Write a study from a template, by the worker, and answer with its answer.

    The body has ``template``, ``path`` and ``numbers``.
    """
    body = await request.json()
    bench.opened.inside(body["path"])
    return await bench.worked("init", {key: body[key] for key in ("template", "path", "numbers")})


async def _study(bench: Workbench, request: Request) -> Response:
    return await asyncio.to_thread(lambda: Json(study_answer(*bench.opened.text(request.query_params["study"]))))


async def _kinds(bench: Workbench, _: Request) -> Response:
    return await bench.worked("kinds", {}, __version__)


async def _sections(_: Workbench, __: Request) -> Response:
    return Json(presets())


async def _section(_: Workbench, request: Request) -> Response:
    """Answer with the properties, in SI units, of an element with the material and cross-section in the request.

    The body has ``element``, ``material``, ``shape`` and ``sizes`` (mm), and may have ``is_turned``; see
    `element_properties`.
    """
    body = await request.json()
    element, material, shape, sizes = (body[key] for key in ("element", "material", "shape", "sizes"))
    return Json(element_properties(element, material, shape, sizes, bool(body.get("is_turned"))))


async def _line(bench: Workbench, request: Request) -> Response:
    study = request.query_params["study"]
    return await bench.worked("line", {"study": study}, bench.version(study))


async def _save(bench: Workbench, request: Request) -> Response:
    """Save the text of a study and answer with its new content; a study that was changed in the meantime stays.

    The body has ``study`` (path), ``text`` and ``digest``, that of the text before ("" for a new file). `ChangedError`
    if that is not the file's.
    """
    body = await request.json()

    def saved() -> Response:
        mark = bench.opened.save(body["study"], body["text"], body["digest"])
        return Json(study_answer(body["text"], mark))

    return await asyncio.to_thread(saved)


async def _edit(bench: Workbench, request: Request) -> Response:
    """Apply edits to a study, save it and answer with its new content; `ChangedError` if it was changed meanwhile.

    The body has ``study`` (path), ``edits`` and ``digest``, that of the text that the page has.
    """
    body = await request.json()

    def saved() -> Response:
        """Response with the edited and saved study that the request's body names, applying the body's ``edits``.

        Raises `ChangedError` if the file was changed since the page read it, by the body's ``digest``.
        """
        text, mark = bench.opened.text(body["study"])
        if mark != body["digest"]:
            raise ChangedError(f"{body['study']}: was changed by another page or program; what it says now is shown")
        changed = edited(text, body["edits"])
        return Json(study_answer(changed, bench.opened.save(body["study"], changed, mark)))

    return await asyncio.to_thread(saved)


def _of_study(name: str, **numbers: int) -> Handler:
    """Handler that calls the worker function `name` for the ``study`` in the query; its answer is cached.

    The cache holds until a file in the study's folder changes. `numbers` are further integer parameters of the query
    with their defaults.
    """

    async def asked(bench: Workbench, request: Request) -> Response:
        """Answer of the worker function `name` for the ``study`` and the `numbers` in the query.

        It is cached until a file in the folder that holds the study changes.
        """
        study = request.query_params["study"]
        own = {key: int(request.query_params.get(key, default)) for key, default in numbers.items()}
        arguments: dict[str, Any] = {"study": study, **own}
        return await bench.worked(name, arguments, bench.version(study))

    return asked


def _of_body(name: str, *keys: str) -> Handler:
    """Handler that calls the worker function `name` with the entries `keys` of the request's JSON body.

    All entries must be there. Nothing is cached.
    """

    async def asked(bench: Workbench, request: Request) -> Response:
        body = await request.json()
        return await bench.worked(name, {key: body[key] for key in keys})

    return asked


async def _facts(bench: Workbench, request: Request) -> Response:
    """Answer with kind, channels and findings of a data file, by the worker function ``facts``.

    The body has ``record``, the path of the file, and ``options`` for reading it. The answer is cached until the file
    changes.
    """
    body = await request.json()
    path = bench.opened.inside(body["record"])
    stamp = path.stat() if path.is_file() else None
    version = f"{stamp.st_mtime_ns} {stamp.st_size}" if stamp else ""
    return await bench.worked("facts", {key: body[key] for key in ("record", "options")}, version)


async def _lines(bench: Workbench, request: Request) -> Response:
    """Answer with ``lines``, the first 12 lines of a text file, each cut after 400 characters.

    Of the file 20 kB are read. The body names the ``record`` and may name the ``encoding``, UTF-8 by default; signs
    that it does not have are replaced. `InputError` for an unknown encoding, `FileError` for a missing file.
    """
    body = await request.json()
    path, encoding = bench.opened.inside(body["record"]), str(body.get("encoding") or "utf-8")
    try:
        content = await asyncio.to_thread(read_start, path, _PREVIEW_BYTES)
        text = content.decode(encoding, "replace")
    except FileNotFoundError:
        raise FileError(f"{body['record']}: is not there any more; put it back, or choose another record") from None
    except LookupError:
        raise InputError(f"there is no encoding {encoding!r}; write utf-8, cp1252 or utf-16") from None
    lines = text.splitlines()[:_PREVIEW_LINES]
    return Json({"lines": [line[:_PREVIEW_LETTERS] for line in lines]})


def _modes_folder(name: str, *keys: str) -> Handler:
    """Handler that lets the worker function `name` write a folder of modes, and answers with its result and report.

    `keys` are the entries of the request's JSON body that the function takes; ``out`` in the body is the folder, which
    may exist only with ``replace``. The address of the report is ``page`` in the answer.
    """

    async def asked(bench: Workbench, request: Request) -> Response:
        """JSON answer of the function `name` and, as ``page``, the address of the written report ("" if there is none).

        The body of `request` has ``out``, the folder to write, and the `keys`. `ChangedError` if the folder exists and the body
        does not say ``replace``. If the function fails, status 422 with its ``error`` alone.
        """
        body = await request.json()
        if bench.opened.inside(body["out"]).exists() and not body.get("replace"):
            raise ChangedError(f"{body['out']}: is there already; give another folder, or replace what is in it")
        answer = json.loads(await bench.workers(name, {key: body[key] for key in keys}))
        if "error" in answer:
            return Json(answer, 422)
        page = f"{body['out']}/report.html"
        shown = bench.shown(page) if bench.opened.inside(page).is_file() else ""
        return Json({**answer, "page": shown})

    return asked


async def _histories(bench: Workbench, request: Request) -> Response:
    """Answer with minimum and maximum of time histories in bins, by the worker function ``histories``.

    The body has ``record``, ``options``, ``first``, ``last`` and ``points``. If the answer came from short pieces of a
    long record, the record's overview is written in the background, unless the folder cannot be written.
    """
    body = await request.json()
    arguments = {key: body[key] for key in ("record", "options", "first", "last", "points")}
    answer = await bench.workers("histories", arguments)
    if '"sampled":true' in answer and bench.opened.is_writable:
        part = {"record": body["record"], "options": body["options"]}
        _later(bench.workers("overview", part))
    return _answered(answer)


def _later(work: Any) -> None:
    """Start the coroutine `work` in the background, and hold it until it has ended."""
    task = asyncio.ensure_future(work)
    _tasks.add(task)
    task.add_done_callback(_tasks.discard)


async def _upload(bench: Workbench, request: Request) -> Response:
    """Store the body of the request as a file at the top of the open folder, and answer with its ``path``.

    The query has ``name``, and ``replace=yes`` if the file may exist. Raises `InputError` if the body is empty or
    larger than 4 GB, or a file of this name arrives already, or exists and is not to be replaced; `FileError` if it
    does not arrive whole. Nothing is kept then.
    """
    name = upload_name(request.query_params["name"])
    path, is_replaced = bench.opened.inside(name), request.query_params.get("replace") == "yes"
    if path in _arriving:
        raise InputError(f"{name}: another file of this name is arriving; rename one of them")
    if path.exists() and not is_replaced:
        raise InputError(f"{name}: is there already; rename the new file, or remove the old one")
    taken = 0
    _arriving.add(path)
    try:
        with claim_path(path), atomic_write(path, is_new=not is_replaced) as temporary, temporary.open("wb") as stream:
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
    finally:
        _arriving.discard(path)
    return Json({"path": name})


async def _solver(bench: Workbench, study: str) -> dict[str, Any]:
    """Solver command that `study` would run, with its ``confirmation``; {} if it runs none.

    Raises `InputError` if the study cannot be read.
    """
    command: dict[str, Any] = json.loads(await bench.workers("solver", {"study": study}))
    if "error" in command:
        raise InputError(command["error"])
    return command


async def _start_run(bench: Workbench, request: Request) -> Response:
    """Start a run of a study and answer with its summary.

    The body has ``study`` and ``results``, and may have ``resume``, ``replace``, ``explain``, ``seconds`` and
    ``confirmed``. If the study runs a solver command that the user has not confirmed, status 428 with that command
    instead; ``confirmed``, with the text that the command came with, confirms it from now on.
    """
    body = await request.json()
    study, confirmed = body["study"], body.get("confirmed", "")
    bench.opened.inside(study)
    solver = await _solver(bench, study)
    confirmation = solver.get("confirmation", "")
    if solver and confirmed == confirmation:
        await asyncio.to_thread(remember_confirmed, confirmation)
    elif solver and not await asyncio.to_thread(is_confirmed, confirmation):
        words = "this study runs a program of this machine; look at its command, and confirm it"
        return Json({"error": words, "solver": solver}, 428)
    run = await asyncio.to_thread(
        bench.runs.start,
        study,
        body["results"],
        bool(body.get("resume")),
        bool(body.get("replace")),
        confirmation,
        None if body.get("seconds") is None else float(body["seconds"]),
        bool(body.get("explain")),
    )
    return Json(run.summary())


async def _run(bench: Workbench, request: Request) -> Response:
    return Json(bench.runs[request.path_params["id"]].progress(int(request.query_params.get("after", 0))))


async def _act(bench: Workbench, request: Request) -> Response:
    """Stop, pause or continue a run, by ``id`` and ``action`` in the path, and answer with its summary.

    `InputError` for another action or a run that is not there.
    """
    run, action = bench.runs[request.path_params["id"]], request.path_params["action"]
    if action == "stop":
        run.stop()
    elif action in ("pause", "continue"):
        run.pause(action == "pause")
    else:
        raise InputError(f"a run can stop, pause and continue, not {action}")
    return Json(run.summary())


class Watcher:
    """One look at a folder for all pages that are open on it, as long as there are any."""

    def __init__(self, opened: OpenFolder, runs: Runs) -> None:
        """Watcher of the folder `opened` and its `runs`; it polls only while it has listeners."""
        self._opened, self._runs = opened, runs
        self._state, self._count = "", 0
        self._task: asyncio.Task[None] | None = None
        self._changed = asyncio.Event()
        self.n_heard = 0

    async def _watch(self) -> None:
        """Poll folder and runs every 0.5 s until cancelled, and wake all listeners when their state has changed.

        The new state is stored as JSON text, and changes are counted.
        """
        while True:
            state = json.dumps(await asyncio.to_thread(self._look))
            if state != self._state:
                self._state, self._count = state, self._count + 1
                self._changed.set()
                self._changed = asyncio.Event()
            await asyncio.sleep(_TICK)

    def _look(self) -> dict[str, Any]:
        return {"runs": self._runs.summaries(), "studies": self._opened.stamps()}

    async def states(self, is_over: Callable[[], Awaitable[bool]]) -> AsyncIterator[str]:
        """Yield the state of runs and studies as JSON text at first and after each change, until `is_over` returns True.

        After every 15 s or so without a change, "" is yielded.
        """
        self.n_heard += 1
        if self._task is None:
            self._task = asyncio.create_task(self._watch())
        count, quiet = 0, 0
        try:
            while not await is_over():
                if self._count > count:
                    count, quiet = self._count, 0
                    yield self._state
                    continue
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._changed.wait(), 2 * _TICK)
                quiet += 1
                if quiet % 15 == 0:
                    yield ""
        finally:
            self.n_heard -= 1
            if not self.n_heard and self._task is not None:
                self._task.cancel()
                self._task, self._state, self._count = None, "", 0


async def _events(bench: Workbench, request: Request) -> Response:
    """Stream server-sent events to the page: states of runs and stamps of study files, whenever they change.

    Status 503 if 64 pages listen already.
    """
    if bench.watcher.n_heard >= _MOST_STREAMS:
        return Json({"error": "too many pages of this folder are open; close some"}, 503)

    async def is_over() -> bool:
        return bench.ending.is_set() or await request.is_disconnected()

    async def changes() -> AsyncIterator[str]:
        async for state in bench.watcher.states(is_over):
            yield f"data: {state}\n\n" if state else ": still here\n\n"

    return StreamingResponse(changes(), media_type="text/event-stream", headers={"x-accel-buffering": "no"})


async def _results(bench: Workbench, request: Request) -> Response:
    """Answer with the main entries of estimate.json (``results``), ``files`` of the folder, and the report's address.

    The latter is ``report``, "" if there is none. At most 200 files are listed, with path and size in bytes.
    `FileError` if the folder ``results`` in the query has no results.
    """
    name = request.query_params["results"]
    folder = bench.opened.inside(name)
    estimate = await asyncio.to_thread(read_json, bench.opened.inside(f"{name}/estimate.json"))
    if not isinstance(estimate, dict):
        raise FileError(f"{name}: holds no results; run the study first")
    kept = await asyncio.to_thread(bench.opened.files_in, folder, _MOST_RESULTS)
    seen = [path for path in kept if path.suffix in _SEEN]
    listed = [{"path": bench.opened.name(path), "bytes": path.stat().st_size} for path in seen[:200]]
    page = f"{name}/report.html"
    shown = bench.shown(page) if (folder / "report.html").is_file() else ""
    keys = (
        "title",
        "status",
        "status_text",
        "verdict",
        "verdict_text",
        "verdict_reasons",
        "headline",
        "next_step",
        "advice",
        "causes",
        "suggestions",
        "parameters",
        "total_mass",
        "modes",
        "warnings",
        "chi_square_per_dof",
    )
    return Json({"results": {key: estimate.get(key) for key in keys}, "files": listed, "report": shown})


def _of_results(name: str) -> Handler:
    """Handler that calls the worker function `name` for the folder ``results`` in the query; its answer is cached.

    The cache holds until estimate.h5 or a file in the folder that holds this folder changes.
    """

    async def asked(bench: Workbench, request: Request) -> Response:
        """Answer of the worker function `name` for the folder ``results`` in the query.

        It is cached until estimate.h5 or a file beside the folder changes; not without an estimate.h5.
        """
        results = request.query_params["results"]
        path = bench.opened.inside(f"{results}/estimate.h5")
        version = f"{bench.version(results)} {path.stat().st_mtime_ns}" if path.is_file() else ""
        return await bench.worked(name, {"results": results}, version)

    return asked


async def _view(bench: Workbench, request: Request) -> Response:
    """Answer with the HTML report at the path ``name`` in the open folder; status 404 for any other file."""
    path = bench.opened.inside(request.path_params["name"])
    if path.suffix != ".html" or not path.is_file():
        return PlainTextResponse("There is no such page.", 404)
    return FileResponse(path, media_type="text/html; charset=utf-8")


async def _download(bench: Workbench, request: Request) -> Response:
    """Answer with the file ``path`` of the query as a download.

    `FileError` if it is missing or of a kind that is not served; in folders of exports more kinds are served.
    """
    path = bench.opened.inside(request.query_params["path"])
    seen = _EXPORTED if path.parent.name.endswith(EXPORTS) else _SEEN
    if not path.is_file() or path.suffix not in seen:
        raise FileError(f"{request.query_params['path']}: is not there any more")
    return FileResponse(path, filename=path.name, media_type="application/octet-stream")


async def _export(bench: Workbench, request: Request) -> Response:
    """Answer with the folder ``results`` of the query as a ZIP archive of at most 2000 files.

    Links and hidden files are left out. The archive is deleted from the server afterwards. `FileError` if the folder
    has no results.
    """
    folder = bench.opened.inside(request.query_params["results"])
    if not (folder / "estimate.json").is_file():
        raise FileError(f"{request.query_params['results']}: holds no results")
    with tempfile.NamedTemporaryFile(suffix=".zip", delete=False) as made:
        target = Path(made.name)
    try:
        await asyncio.to_thread(_archive, bench.opened.files_in(folder, _MOST_RESULTS), folder, target)
    except BaseException:
        target.unlink(missing_ok=True)
        raise
    return FileResponse(
        target, filename=f"{folder.name}.zip", media_type="application/zip", background=BackgroundTask(target.unlink)
    )


def _archive(paths: list[Path], folder: Path, target: Path) -> None:
    """Write files into the ZIP archive `target`, under the name of `folder`, which holds them."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as archive:
        for path in paths:
            archive.write(path, f"{folder.name}/{path.relative_to(folder).as_posix()}")


def study_answer(text: str, digest: str) -> dict[str, Any]:
    """Study for the web page: ``text``, ``digest``, parsed ``table``, and ``broken``, the line and message of a TOML error.

    ``table`` is None if the text is broken, else ``broken`` is None. Above 3 million characters, ``table`` lacks ``structure``.
    """
    try:
        table = parse_toml(text)
    except (ValueError, RecursionError) as error:
        line_match = re.search(r"at line (\d+)", str(error))
        line = int(line_match[1]) if line_match else text.count("\n") + 1
        return {"text": text, "digest": digest, "table": None, "broken": {"line": line, "words": str(error)}}
    if len(text) > _LONG:
        table = {name: part for name, part in table.items() if name != "structure"}
    return {"text": text, "digest": digest, "table": _as_json_value(table), "broken": None}


@cache
def reading_keys() -> list[dict[str, Any]]:
    """Options of ``[record]`` and ``[record.csv]`` for reading a file, as mappings for the page, in their order.

    Each has ``name``, ``words`` (description), ``default`` ("" for none) and ``choices`` ([] if it is free). ``within``
    is "csv" for keys of ``[record.csv]``, else ""; ``is_list`` and ``is_number`` tell the type.
    """
    options = []
    for name, key in table_of(ReadOptions).keys.items():
        inner = key.holds.keys if isinstance(key.holds, Table) else {name: key}
        for own, one in inner.items():
            schema = one.holds.schema
            options.append(
                {
                    "name": own,
                    "within": name if own != name else "",
                    "words": one.description.replace("`", ""),
                    "default": "" if one.default is None else one.default,
                    "choices": schema.get("enum", []),
                    "is_list": "array" in str(schema),
                    "is_number": schema.get("type") in ("number", "integer"),
                }
            )
    return options


def _as_json_value(value: Any) -> Any:
    """Copy of `value` that can be written as JSON: dates, times and non-finite numbers become text."""
    if isinstance(value, dict):
        return {key: _as_json_value(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_as_json_value(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return str(value) if isinstance(value, datetime.date | datetime.time) else value


#: Method, path and handler of every address.
ROUTES: tuple[tuple[str, str, Handler], ...] = (
    ("GET", "/", _index),
    ("GET", "/static/{name}", _file),
    ("GET", "/static/steps/{name}", _step),
    ("GET", "/static/editor/{name}", _editor),
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
    ("GET", "/api/kinds", _kinds),
    ("GET", "/api/sections", _sections),
    ("POST", "/api/sections", _section),
    ("GET", "/api/scene", _of_study("scene", number=0)),
    ("GET", "/api/channels", _of_study("channels", number=0)),
    ("GET", "/api/check", _of_study("check")),
    ("GET", "/api/modelled", _of_study("modelled", number=0)),
    ("GET", "/api/needs", _of_study("needs")),
    ("GET", "/api/plan", _of_study("plan", sensors=4)),
    ("POST", "/api/mesh", _of_body("mesh", "path", "length_unit")),
    ("POST", "/api/facts", _facts),
    ("POST", "/api/lines", _lines),
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
    ("GET", "/api/fits", _of_results("fits")),
    ("GET", "/api/identified", _of_results("identified")),
    ("GET", "/api/use", _of_results("use")),
    ("POST", "/api/predict", _of_body("predict", "results", "options", "changes")),
    ("POST", "/api/exports", _of_body("exports", "results", "kind", "suffix", "options")),
    ("GET", "/api/download", _download),
    ("GET", "/api/export", _export),
)
