"""All ratios of structid's speed and memory beside their bars, in one table.

    python benchmarks/all.py [--quick] [--json FILE] [--only NAME]

Each module of `MODULES` has a function ``rows(quick: bool)`` that returns a list of dictionaries with the keys what,
bar, figure, met and detail: ratios of two sides in one run, medians of five. Each runs in a process of its own, one
after another; one that fails is reported and the others still run. The exit code is 1 where one failed or a bar was
missed. `--quick` leaves the largest sizes out.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
MODULES = ("time_domain", "frequency_domain", "modal_scale", "cluster")
KEYS = ("what", "bar", "figure", "met", "detail")
PACKAGES = (
    "structid", "numpy", "scipy", "numba", "scikit-fem", "h5py", "threadpoolctl", "mkl", "dask", "distributed",
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="leave the largest sizes out")
    parser.add_argument("--json", type=Path, help="also write figures and machine to this file")
    parser.add_argument("--only", choices=MODULES, action="append", help="one module; may be given several times")
    parser.add_argument("--rows-of", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.rows_of:
        write_rows(given.rows_of, given.quick, given.json)
        return 0
    before = machine()
    print(f"{before['processor']}, {before['cores']} cores, load {before['load']}", flush=True)
    print(", ".join(f"{name} {version}" for name, version in before["versions"].items()))
    print(f"\n{'what':76s} {'figure':>10s} {'bar':>10s}         detail", flush=True)
    results = []
    for name in given.only or MODULES:
        result = run(name, given.quick)
        results.append(result)
        for line in lines(result):
            print(line, flush=True)
    rows = [row for result in results for row in result["rows"]]
    failed = [result["module"] for result in results if result["error"]]
    met = sum(bool(row["met"]) for row in rows)
    print(f"\n{met} of {len(rows)} bars met" + (f"; failed: {', '.join(failed)}" if failed else ""))
    if given.json:
        whole = {"quick": given.quick, "machine": before, "load_after": load(), "modules": results}
        given.json.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    return int(bool(failed) or met < len(rows))


def run(name: str, quick: bool) -> dict[str, Any]:
    """The rows of one module, from a process of its own, or what it failed with."""
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "rows.json"
        command = [sys.executable, str(FOLDER / "all.py"), "--rows-of", name, "--json", str(out)]
        paths = [str(FOLDER), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
        done = subprocess.run(
            [*command, "--quick"] if quick else command, capture_output=True, text=True, env=environment, check=False
        )
        rows = json.loads(out.read_text(encoding="utf-8")) if done.returncode == 0 else []
    said = done.stderr.strip().splitlines()
    error = (said[-1] if said else f"ended with code {done.returncode}") if done.returncode else ""
    seconds = time.perf_counter() - begun
    return {"module": name, "seconds": seconds, "error": error, "said": said[-40:] if error else [], "rows": rows}


def write_rows(name: str, quick: bool, out: Path) -> None:
    """Measure in this process, and write the rows to `out`.

    Raises
    ------
    SystemExit
        If the module has no function `rows`, or its rows lack a key; the message says which.
    """
    module = importlib.import_module(name)
    if not callable(getattr(module, "rows", None)):
        raise SystemExit(f"benchmarks/{name}.py has no function rows(quick); add it, or leave the module out")
    found = module.rows(quick)
    for row in found:
        missing = [key for key in KEYS if key not in row]
        if missing:
            raise SystemExit(f"benchmarks/{name}.py: a row lacks {', '.join(missing)}: {row}")
    out.write_text(json.dumps([{key: plain(row[key]) for key in KEYS} for row in found]), encoding="utf-8")


def plain(value: Any) -> Any:
    """A NumPy number as one of Python; None for NaN, which JSON does not know."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and math.isnan(value) else value


def lines(result: dict[str, Any]) -> list[str]:
    """What the table says of one module."""
    made = [f"{result['module']} ({result['seconds']:.0f} s)"]
    for row in result["rows"]:
        figure, bar = (f"{v:.3g}" if isinstance(v, float) else str(v) for v in (row["figure"], row["bar"]))
        verdict = "met   " if row["met"] else "MISSED"
        made.append(f"  {row['what']:74s} {figure:>10s} {bar:>10s} {verdict}  {row['detail']}")
    if result["error"]:
        made.append(f"  FAILED: {result['error']}")
    return made


def machine() -> dict[str, Any]:
    """What the figures were taken on."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "processor": processor(),
        "cores": cores,
        "load": load(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": versions,
        "blas": blas(),
    }


def blas() -> list[str]:
    """Linear algebra libraries that NumPy and SciPy bring."""
    import numpy as np  # noqa: F401
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info

    found = [f"{one['internal_api']} {one['version']} ({one.get('architecture', '')})" for one in threadpool_info()]
    return sorted(set(found))


def load() -> float | None:
    """Processes that ran or waited in the last minute."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def processor() -> str:
    """Its name, as far as the system tells."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


if __name__ == "__main__":
    sys.exit(main())
