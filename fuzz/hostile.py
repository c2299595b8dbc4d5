"""Folders as a stranger may send them: odd names, links, devices, bombs, and modules that Python would import.

``python -m fuzz.hostile`` makes one, lets the workbench list it, and prints what that took.
"""

from __future__ import annotations

import io
import os
import sys
import time
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fuzz.seeds import CHAIN, write_chain

#: Modules that any process of structid imports, and those that Python imports by itself.
MODULES = (
    "structid", "sitecustomize", "usercustomize", "site", "numpy", "scipy", "h5py", "matplotlib", "numba", "rich", "typer",
    "starlette", "uvicorn", "tomlkit", "psutil", "jinja2", "threadpoolctl", "emcee", "arviz", "anyio", "yaml", "click", "IPython",
    *sorted(sys.stdlib_module_names - {"__main__", "builtins", "sys"}),
)  # fmt: skip
#: Settings that libraries look for in the working directory.
SETTINGS = {
    "matplotlibrc": "figure.facecolor: red\n",
    ".numba_config.yaml": "disable_jit: 1\n",
    "arvizrc": "stats.ci_prob: 0.1\n",
    ".env": "PYTHONPATH=.\n",
    "setup.cfg": "[metadata]\n",
    "pyvenv.cfg": "home = .\n",
    "_evil.pth": "import evil\n",
}
_RECORDER = """
import os, sys

_FOLDER, _LOG = {folder!r}, os.open({log!r}, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

def _note(event, given):
    if event in ("open", "import") and given and isinstance(given[1] if event == "import" else given[0], (str, bytes)):
        path = os.path.normpath(os.path.join(os.getcwd(), os.fsdecode(given[1] if event == "import" else given[0])))
        if path.startswith(_FOLDER + os.sep):
            os.write(_LOG, (path[len(_FOLDER) + 1 :] + chr(10)).encode("utf-8", "surrogateescape"))

sys.addaudithook(_note)
"""


def write_modules(folder: Path) -> None:
    """Write a module for every name that Python or structid may import, each of which leaves its name in ``harmed``."""
    for name in MODULES:
        code = f"open({str(folder / 'harmed')!r}, 'a').write({name + chr(10)!r})\n"
        (folder / f"{name}.py").write_text(code, encoding="utf-8")
    package = folder / "structid"
    package.mkdir()
    (package / "__init__.py").write_text(
        f"open({str(folder / 'harmed')!r}, 'a').write('package\\n')\n", encoding="utf-8"
    )
    for name, text in SETTINGS.items():
        (folder / name).write_text(text, encoding="utf-8")


def write_good_study(path: Path) -> None:
    """Write a study whose model explains its record, so that nothing is sought after the fit."""
    write_chain(
        path, CHAIN.replace("viscous_damping = 2.0", "viscous_damping = 3.0").replace("restarts = 1", "restarts = 0")
    )


def recording_environment(folder: Path, beside: Path) -> tuple[Path, dict[str, str]]:
    """Give a log of what Python opens in `folder`, and the environment in which every process writes there.

    The hook is a ``sitecustomize`` of `beside`, a folder that the user trusts.
    """
    log = beside / "opened.txt"
    (beside / "sitecustomize.py").write_text(_RECORDER.format(folder=str(folder), log=str(log)), encoding="utf-8")
    return log, {"PYTHONPATH": str(beside)}


def write_odd_entries(folder: Path) -> int:
    """Write what makes programs stumble beside a good study ``good.toml``, and give the number of entries."""
    write_good_study(folder / "good.toml")
    for name, content in _odd_files().items():
        (folder / name).write_bytes(content)
    for name, target in _LINKS.items():
        (folder / name).symlink_to(target)
    for name, make in _SPECIAL.items():
        with suppress(OSError, AttributeError):  # a file system or system without them
            make(folder / name)
    for k, name in enumerate(_ODD_NAMES):
        with suppress(OSError):
            Path(os.fsdecode(os.fsencode(folder) + b"/" + name)).write_bytes(b'title = "odd"\n[structure]\n' + b"#" * k)
    deep = folder
    for _ in range(60):
        deep = deep / "d"
        deep.mkdir()
    (deep / "deep.toml").write_text("[structure]\n", encoding="utf-8")
    results = folder / "damaged_results"
    results.mkdir()
    (results / "estimate.json").write_text("[" * 100_000, encoding="utf-8")
    runs = folder / ".structid" / "runs"
    for k, content in enumerate(_DAMAGED_RUNS):
        (runs / f"2026010{k}-000000-aaaaaa").mkdir(parents=True)
        (runs / f"2026010{k}-000000-aaaaaa" / "run.json").write_bytes(content)
        (runs / f"2026010{k}-000000-aaaaaa" / "ended.json").write_bytes(content)
    return sum(1 for _ in os.scandir(folder)) + len(_DAMAGED_RUNS)


_DAMAGED_RUNS = (
    b"{}", b"[]", b"null", b"[" * 100_000, b'{"study": 7, "results": [1], "started": "now", "pid": "x"}', b"\xff\xfe",
    b'{"study": "../x.toml", "results": "../../etc", "started": 1e999, "pid": 1, "born": 0}', b'{"code": ' + b"9" * 5000 + b"}",
    b'{"results": "good.toml/x", "study": "good.toml", "code": {}}', b'{"results": "\\u0000", "study": "\\ud800"}',
)  # fmt: skip
_LINKS = {
    "annexed.npz": ".git/annex/objects/zz/SHA256E-s1--0.npz", "dangling.toml": "nowhere.toml", "itself.toml": "itself.toml",
    "device.toml": "/dev/zero", "device.csv": "/dev/zero", "random.txt": "/dev/urandom", "stdin.toml": "/dev/stdin",
    "secrets.toml": "/etc/passwd", "secrets.csv": "/etc/passwd", "root_link": "/", "loop": ".", "full.npz": "/dev/full",
    "a_loop.json": "b_loop.json", "b_loop.json": "a_loop.json", "process.txt": "/proc/self/environ",
}  # fmt: skip
_ODD_NAMES = (
    "Träger".encode("latin-1") + b".toml", b"\xff\xfe.csv", b"line\nbreak.toml", b"tab\t.toml", b"bell\x07.toml", b" .toml",
    b"-rf.toml", b"--out.toml", b"$(touch x).toml", b"`id`.toml", b"a;b.toml", b"'quoted'.toml", b'"double".toml', b"%00.toml",
    b"..toml", b"...toml", b"a..b.toml", b"con.toml", b"x" * 250 + b".toml", b"\xe2\x80\xae" + b"lmot.toml",
    b"\xf0\x9f\x92\xa9.toml",
    b"<img src=x>.toml", b"a&b=c#d?e.toml", b"back\\slash.toml", b"UPPER.TOML", b"{stem}.toml", b"*.toml", b"c:d.toml",
)  # fmt: skip


def _odd_files() -> dict[str, bytes]:
    """Bombs and damage, by name."""
    line = b"1," * 30 + b"1x\n"
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (50_000_000,)})
        archive.writestr("values.npy", header.getvalue() + b"\0" * 8_000_000)
    return {
        "numbers.txt": line, "longer.txt": b"1," * 2000 + b"x\n", "minus.txt": b"-" * 4096, "points.txt": b"1.e+," * 1000 + b"x",
        "letters.csv": line * 40, "quotes.csv": b'"' * 100_000, "commas.csv": b"," * 1_000_000, "nul.txt": b"\0" * 100_000,
        "lines.txt": b"\n" * 100_000, "wide.txt": b"9" * 1_000_000, "deep.toml": b"a = " + b"[" * 40_000,
        "deep_table.toml": b"[structure]\na = " + b"{a=" * 20_000, "dotted.toml": b"a" + b".a" * 20_000 + b" = 1\n",
        "number.toml": b"[structure]\na = " + b"9" * 5000, "keys.toml": b"[structure]\n" + b"a.b.c.d.e.f = 1\n" * 3,
        "headers.toml": b"".join(b"[a%d.b.c.d.e.f.g.h]\n" % k for k in range(2000)),
        "not_utf8.toml": b'title = "\xff"\n[structure]\n',
        "title.toml": b'title = """' + b"x" * 1_000_000 + b'"""\n[structure]\n', "number_title.toml": b"title = 7\n[structure]\n",
        "bom.toml": "﻿[structure]\n".encode(), "empty.toml": b"", "binary.toml": bytes(range(256)) * 100,
        "deep.json": b"[" * 100_000, "modes.json": b'{"title": "' + b"\\" * 100_000, "number.json": b"9" * 5000,
        "frequency.json": b'{"title": "a", ' * 3000, "bomb.npz": packed.getvalue(), "half.npz": packed.getvalue()[:200],
        "half.npy": b"\x93NUMPY\1\0v\0", "empty.csv": b"", "empty.h5": b"", "no.h5": b"\x89HDF\r\n\x1a\n" + b"\xff" * 200,
        "no.uff": b"    -1\n" * 20_000, "punch.pch": b"$EIGENVALUE" * 1000, "a.f06": b"\n" * 1000,
        "no.wav": b"RIFF\xff\xff\xff\xffWAVE",
        "no.mat": b"MATLAB 5.0 MAT-file" + b"\xff" * 500, "no.bdf": b"INCLUDE '/etc/passwd'\n",
        "no.msh": b"$Nodes\n99999999999999\n",
    }  # fmt: skip


def _sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(2 * 2**30)


def _unreadable(path: Path) -> None:
    path.write_text("[structure]\n", encoding="utf-8")
    path.chmod(0)


def _socket(path: Path) -> None:
    import socket

    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(path))


_SPECIAL: dict[str, Callable[[Path], None]] = {
    "fifo.toml": lambda path: os.mkfifo(path), "fifo.csv": lambda path: os.mkfifo(path), "fifo.txt": lambda path: os.mkfifo(path),
    "modes_fifo.json": lambda path: os.mkfifo(path), "sparse.toml": _sparse, "sparse.csv": _sparse, "sparse.json": _sparse,
    "sparse.txt": _sparse, "sparse.npz": _sparse, "folder.toml": Path.mkdir, "folder.csv": Path.mkdir,
    "unreadable.toml": _unreadable, "socket.toml": _socket,
}  # fmt: skip


#: Contents of a megabyte for a line, or of lines, on which patterns are slow.
HOSTILE_LINES = (
    b"1," * 500_000 + b"x", b"9" * 1_000_000, b" " * 1_000_000 + b"x", b"1.e+," * 200_000 + b"x", b"-1" * 500_000, b"," * 1_000_000,
    b"frequency_hz," + b"a," * 500_000, b"frequency [hz]\n" + b"1\n" * 500_000, b'{"title":"' + b"\\a" * 500_000,
    b'{"title":"a",' * 80_000, b"    -1\n" * 140_000, b"    -1\n" + b" " * 1_000_000, b"\n" * 1_000_000,
    b"\n    5" * 160_000, b"    -1\n    58\n" * 70_000, b"    -1\n    55" + b" \r" * 400_000,
    b"frequency_hz,1" + b" " * 900_000 + b"x,1X", b"frequency_hz," + b"1  X ," * 160_000,
)  # fmt: skip


def processor_seconds(work: Callable[[Path], object], path: Path) -> float:
    """The least of three: another process may take the processor."""
    seconds = []
    for _ in range(3):
        begun = time.process_time()
        work(path)
        seconds.append(time.process_time() - begun)
    return min(seconds)


def slowest_line(folder: Path) -> float:
    """Processor time of the slowest look of a list at `HOSTILE_LINES`, s."""
    from structid.workbench.folder import holds_modes, holds_numbers

    seconds = []
    for content in HOSTILE_LINES:
        for suffix in (".txt", ".csv", ".json", ".uff", ".pch"):
            path = folder / f"line{suffix}"
            path.write_bytes(content)
            seconds += [processor_seconds(holds_modes, path), processor_seconds(holds_numbers, path)]
    return max(seconds)


def main() -> None:
    """Make a hostile folder, list it, and print the time and memory that this takes."""
    import psutil

    from structid.workbench.folder import open_study_folder

    with TemporaryDirectory() as made:
        folder = Path(made) / "hostile"
        folder.mkdir()
        count = write_odd_entries(folder)
        before = psutil.Process().memory_info().rss
        seconds = processor_seconds(lambda path: open_study_folder(path).listing(), folder)
        more = psutil.Process().memory_info().rss - before
        print(f"{count} odd entries listed in {seconds:.3f} s of processor time, {more / 1e6:.1f} MB more memory")
        for kind, rows in open_study_folder(folder).listing().items():
            if isinstance(rows, list):
                print(f"  {len(rows)} {kind}")
        print(f"slowest line of 1 MB: {1000 * slowest_line(Path(made)):.1f} ms")


if __name__ == "__main__":
    main()
