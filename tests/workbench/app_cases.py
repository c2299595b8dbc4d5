"""A workbench that serves a folder, requests to it, and a beam's record from its own study."""

from __future__ import annotations

import http.client
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest

import structid as sid
from structid.records.formats import write_record
from structid.study.schema.model.structure import read_structure
from structid.study.schema.section import read_root
from structid.study.schema.unknowns import read_parameters

ROOT = Path(__file__).parent.parent.parent
ENVIRONMENT = {
    **os.environ,
    "OPENBLAS_NUM_THREADS": "1",
    "MPLBACKEND": "Agg",
    "XDG_STATE_HOME": tempfile.mkdtemp(prefix="structid-state-"),  # the user's own list of folders stays as it is
}
_NEEDED = "the workbench's own packages are missing: pip install 'structid[app]'"


def require_workbench() -> None:
    """Skip the module where the extra `app` is not installed."""
    pytest.importorskip("starlette", reason=_NEEDED)
    pytest.importorskip("uvicorn", reason=_NEEDED)


@dataclass(frozen=True)
class Served:
    """A workbench in a process of its own."""

    address: str
    process: subprocess.Popen

    @property
    def port(self) -> int:
        return int(re.search(r":(\d+)/", self.address)[1])

    @property
    def token(self) -> str:
        return self.address.rstrip("/").rpartition("/")[2]

    def ask(
        self,
        method: str,
        path: str,
        body: bytes | None = None,
        headers: dict[str, str] | None = None,
        token: str | None = None,
    ):
        """Status, headers and body of a request; `path` comes after the token."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=600)
        given = {"Host": f"127.0.0.1:{self.port}", **(headers or {})}
        connection.putrequest(method, f"/{self.token if token is None else token}{path}", skip_host=True)
        for name, value in given.items():
            connection.putheader(name, value)
        if body is not None and "Content-Length" not in given:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders()
        if body:
            connection.send(body)
        answer = connection.getresponse()
        found = answer.status, dict(answer.getheaders()), answer.read()
        connection.close()
        return found

    def get(self, name: str, **given: object):
        """Status and JSON of a question."""
        status, _, body = self.ask("GET", f"/api/{name}?{urlencode(given)}")
        return status, json.loads(body)

    def post(self, name: str, body: object):
        """Status and JSON of a request with a body."""
        status, _, found = self.ask(
            "POST", f"/api/{name}", json.dumps(body).encode(), {"Content-Type": "application/json"}
        )
        return status, json.loads(found)


@contextmanager
def served(folder: Path, *words: str, environment: dict[str, str] | None = None) -> Iterator[Served]:
    """`structid app FOLDER` until the block ends."""
    given = {**ENVIRONMENT, **(environment or {})}
    command = [sys.executable, "-m", "structid", "app", str(folder), "--no-browser", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=given)
    try:
        line = process.stdout.readline()
        yield Served(re.search(r"http\S+", line)[0], process)
    finally:
        process.terminate()
        process.wait(300)
        process.stdout.close()


def write_beam_record(
    study: Path, path: Path, outputs: tuple[str, ...], names: tuple[str, ...], stiffer: float = 1.1
) -> None:
    """The FRFs of the beam in `study` with a stiffness `stiffer` times as large and 1 % noise, sensors called `names`."""
    root, files = read_root(study)
    structure = read_structure(root.inner("structure"), files)
    unknown = read_parameters(root, structure)
    start = np.array([stiffer if "stiffness" in name else 1.3 for name in unknown.names]) * unknown.start
    frequency = np.linspace(2.0, 140.0, 400)
    like = sid.FrfRecord(frequency, np.ones((400, len(outputs), 1)), outputs, (outputs[-1],), "accelerance")
    record = sid.simulated_record(
        structure, unknown.started_at(start), like, relative_noise=0.01, rng=np.random.default_rng(3)
    )
    write_record(
        path, sid.FrfRecord(record.frequency, record.values, names, record.inputs, "accelerance", record.variance)
    )


_FILLING = """
import errno, os, pathlib, shutil, collections

def full():
    return os.path.exists({marker!r})

def refusing(real):
    def asked(*given, **named):
        if full():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(*given, **named)
    return asked

def cut(self, content, *given, **named):
    if full():  # as much as there is room for
        _whole(self, content[:3])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))
    return _write[type(content)](self, content, *given, **named)

_whole = lambda self, content: open(self, "wb" if isinstance(content, bytes) else "w").write(content)
_write = {{str: pathlib.Path.write_text, bytes: pathlib.Path.write_bytes}}
pathlib.Path.write_text = pathlib.Path.write_bytes = cut
os.fsync = refusing(os.fsync)
Usage = collections.namedtuple("Usage", "total used free")
_usage = shutil.disk_usage
shutil.disk_usage = lambda path: Usage(9, 9, 0) if full() else _usage(path)
"""


def filling_disk(folder: Path) -> tuple[Path, dict[str, str]]:
    """A file, and the environment of processes to which the disk is full as long as that file is there."""
    marker = folder / "full"
    (folder / "sitecustomize.py").write_text(_FILLING.format(marker=str(marker)), encoding="utf-8")
    return marker, {"PYTHONPATH": os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))}


STOREYS = {"storeys": 3, "stiffness": 1.6e6}
