"""`python -m fuzz.keys`: wrong values for every key that a study file has or could have, and what the commands make of them."""

from __future__ import annotations

import argparse
import itertools
import random
import shutil
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from fuzz.__main__ import Reader, Tally
from fuzz.seeds import CHAIN, Seed, write_chain
from structid.core.dof import parse_dof
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes
from structid.records import TimeRecord
from structid.records.formats import write_record
from structid.study.json_schema import study_schema

#: Written as they stand in the place of a value.
WRONG = (
    "-1", "0", "1", "7", "-0.0", "1e-320", "1e308", "-1e308", "inf", "nan", "1" + "0" * 24, "1" + "0" * 400, "1" + "0" * 5000,
    "true", "false", '""', '" "', '"x"', '"1X"', '"99X"', '"1Q"', '"masses"', '"masses:9"', '"a\\u0000b"', '"\\u001b[31m"',
    '"' + "y" * 3000 + '"', '"."', '".."', '"/dev/zero"', "1979-05-27", "07:32:00", "[]", "[[]]", "[1, 'a']", "[nan]",
    "[-1.0]", "[1e-320, 1e308]", "[1, 2]", "[2.0, 1.0]", "['1X', '1X']", "['masses', 'upper']", "[" * 900 + "]" * 900, "{}",
    "{ a = 1 }", "{ mean = 1e24, std = 1e-320 }", "{ mean = 0.0, std = 0.0 }", "[{}]",
)  # fmt: skip
_LOSS = 'property = "loss_factor"\nelements = ["ground", "upper"]\nname = "springs"'
_VISCOUS = 'property = "viscous_damping"\nelements = "damper"'
_HERE = "the value stands here"
TIME = """\
[record]
path = "history.npz"
[record.time]
relative_noise = 0.01
"""
MODES = """\
[record]
path = "modes.json"
[record.modes]
shape_error = 0.02
"""
PLAN = """\
[plan]
sensors = ["1X", "2X"]
"""


class Place(NamedTuple):
    """A key of a study, by the names and numbers that lead to it."""

    study: str
    path: tuple[str | int, ...]


def make_studies(folder: Path) -> dict[str, Path]:
    """Small studies of each kind of record, and one with a plan, each in a folder of its own with the command it is for."""
    head, _, rest = CHAIN.partition("[record]\n")
    method = rest[rest.index("[method]") :]
    texts = {
        "identify frf": CHAIN,
        "identify time": head.replace("loss_factor = 0.03", "").replace(_LOSS, _VISCOUS)
        + TIME
        + "[method]\nband = [0.1, 12.0]\n",
        "identify modes": head + MODES + "[method]\nrestarts = 1\n",
        "plan frf": head + "[record]\n" + rest[: rest.index("[method]")] + method + PLAN,
    }
    found = {}
    for name, text in texts.items():
        found[name] = folder / name.replace(" ", "_") / "study.toml"
        found[name].parent.mkdir(parents=True)
        write_chain(found[name], text)
        _write_history(found[name].parent / "history.npz")
        shapes = np.array([[0.4, 0.8, 1.0], [1.0, 0.5, -0.8]]).T
        given = np.array([2.2, 6.1]), np.array([0.02, 0.03]), shapes, ("1X", "2X", "3X")
        write_modes(
            found[name].parent / "modes.json", ModalRecord(*given, covariance=np.diag([1e-4, 2e-4, 1e-6, 2e-6]))
        )
    return found


def _write_history(path: Path) -> None:
    """Sixty samples of the chain at rest and then pushed, by the trapezoidal rule."""
    dt, force = 0.02, np.sin(np.arange(60) * 0.4)
    m, c, k = np.diag([2.0, 3.0, 1.0]), np.diag([3.0, 0.5, 0.5]), np.diag([2200.0, 2000.0, 1000.0])
    k[[0, 1, 1, 2], [1, 0, 2, 1]] = -1000.0
    x, v, a = np.zeros((3, 3))
    rows = []
    for f in force:
        x1, v1 = x + dt * v + dt**2 / 4 * a, v + dt / 2 * a
        a = np.linalg.solve(m + dt / 2 * c + dt**2 / 4 * k, np.array([0, 0, f]) - c @ v1 - k @ x1)
        x, v = x1 + dt**2 / 4 * a, v1 + dt / 2 * a
        rows.append([f, *a])
    channels = tuple(map(parse_dof, ("3X", "1X", "2X", "3X")))
    record = TimeRecord(1 / dt, np.array(rows), channels, ("force", *("acceleration",) * 3))
    write_record(path, record)


def places(name: str, tables: Any, schema: dict[str, Any]) -> Iterator[Place]:
    """Every key that a study has, and every one that its tables could have."""
    yield from (Place(name, path) for path in dict.fromkeys(_paths(tables, schema, schema["$defs"], ())))


def _paths(value: Any, schema: Any, parts: Any, at: tuple[str | int, ...]) -> Iterator[tuple[str | int, ...]]:
    if at:
        yield at
    kinds = list(_kinds(schema, parts))
    if isinstance(value, dict):
        properties = {key: held for kind in kinds for key, held in kind.get("properties", {}).items()}
        for key in [*value, *(key for key in properties if key not in value)]:
            yield from _paths(value.get(key), properties.get(key, {}), parts, (*at, key))
    elif isinstance(value, list):
        items = [kind["items"] for kind in kinds if isinstance(kind.get("items"), dict)]
        for number, one in enumerate(value):
            yield from _paths(one, {"anyOf": items}, parts, (*at, number))


def _kinds(schema: Any, parts: Any) -> Iterator[Any]:
    """A schema and all that it may stand for."""
    yield schema
    if "$ref" in schema:
        yield from _kinds(parts[schema["$ref"].rpartition("/")[2]], parts)
    for one in itertools.chain(schema.get("anyOf", ()), schema.get("oneOf", ()), schema.get("allOf", ())):
        yield from _kinds(one, parts)


def with_value(tables: Any, path: tuple[str | int, ...], value: str) -> str:
    """The text of a study with `value` as it stands at `path`."""
    tables = deepcopy(tables)
    table = tables
    for step in path[:-1]:
        table = table[step]
    table[path[-1]] = _HERE
    return tomlkit.dumps(tables).replace(f'"{_HERE}"', value)


def main() -> int:
    """Run, print, and say by the exit code whether anything happened that must not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=0, help="how many cases, drawn from all; 0 is all [default: 0]")
    parser.add_argument("--seed", type=int, default=1, help="of the drawing [default: 1]")
    parser.add_argument("--keep", type=Path, default=None, help="folder for the studies that must not be")
    given = parser.parse_args()
    tally, reader = Tally(), Reader()
    with tempfile.TemporaryDirectory() as name:
        folder, schema = Path(name), study_schema()
        studies = make_studies(folder / "studies")
        tables = {name: tomllib.loads(path.read_text()) for name, path in studies.items()}
        for name, path in studies.items():
            outcome, words = reader.ask(name.split()[0], path)
            if outcome != "read":
                raise SystemExit(f"{name}: the study as it is does not run: {words}")
        cases = [(place, value) for name in studies for place in places(name, tables[name], schema) for value in WRONG]
        if given.count:
            cases = random.Random(given.seed).sample(cases, given.count)
        for number, (place, value) in enumerate(cases):
            path = studies[place.study].with_name(f"wrong_{number}.toml")
            path.write_text(with_value(tables[place.study], place.path, value))
            begun = time.perf_counter()
            command = place.study.split()[0]
            outcome, words = reader.ask(command, path)
            kept = f"{place.study}: {'.'.join(map(str, place.path))} = {value[:60]}"
            if outcome not in ("read", "refused") and given.keep is not None:
                given.keep.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, given.keep / f"{place.study.replace(' ', '_')}_{number}.toml")
            seed = Seed(place.study, command, path, ())
            tally.note(seed, outcome, words, kept, time.perf_counter() - begun)
            path.unlink()
        reader.close()
    return tally.shown()


if __name__ == "__main__":
    sys.exit(main())
