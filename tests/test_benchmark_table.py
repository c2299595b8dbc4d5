"""The table of all benchmarks: every module's rows, and what fails is named while the others run."""

import importlib.util
import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
MODULES = {
    "time_domain": "",
    "frequency_domain": "def rows(quick):\n    raise ValueError('the mesh is gone')\n",
    "modal_scale": "import numpy as np\ndef rows(quick):\n    return [dict(what='a / b', bar='<= 2', "
    "figure=np.float64(1.23456), met=np.True_, detail=f'quick {quick}'), "
    "dict(what='c / d', bar='>= 3', figure=float('nan'), met=False, detail='')]\n",
    "cluster": "def rows(quick):\n    return [dict(what='a', bar=1)]\n",
}


def table(folder, *arguments):
    """What the table prints and keeps, with modules that say little."""
    shutil.copy(BENCHMARKS / "all.py", folder)
    for name, text in MODULES.items():
        (folder / f"{name}.py").write_text(text)
    command = [sys.executable, str(folder / "all.py"), "--json", str(folder / "kept.json"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done, json.loads((folder / "kept.json").read_text())


def test_rows_are_kept_and_what_fails_is_named(tmp_path):
    done, kept = table(tmp_path, "--quick")
    assert done.returncode == 1
    assert "1 of 2 bars met; failed: time_domain, frequency_domain, cluster" in done.stdout
    for words in (
        "benchmarks/time_domain.py has no function rows(quick)",
        "ValueError: the mesh is gone",
        "benchmarks/cluster.py: a row lacks figure, met, detail",
    ):
        assert words in done.stdout
    first, second = kept["modules"][2]["rows"]
    assert first == {"what": "a / b", "bar": "<= 2", "figure": 1.23456, "met": True, "detail": "quick True"}
    assert second["figure"] is None
    assert kept["machine"]["cores"] >= 1
    assert kept["machine"]["versions"]["numpy"] == np.__version__
    assert kept["machine"]["blas"]


def test_one_module_alone_is_run(tmp_path):
    done, kept = table(tmp_path, "--only", "modal_scale")
    assert [one["module"] for one in kept["modules"]] == ["modal_scale"]
    [line] = [line.split() for line in done.stdout.splitlines() if "a / b" in line]
    assert line == ["a", "/", "b", "1.23", "<=", "2", "met", "quick", "False"]


def test_slopes_of_powers_are_their_exponents():
    spec = importlib.util.spec_from_file_location("scaling", BENCHMARKS / "scaling.py")
    scaling = importlib.util.module_from_spec(spec)
    sys.modules["scaling"] = scaling
    try:
        spec.loader.exec_module(scaling)
    finally:
        del sys.modules["scaling"]
    sizes = [1, 10, 30, 100]
    assert scaling.slope(sizes, [9.0, *(2 * n**1.5 for n in sizes[1:])]) == pytest.approx(1.5)
    assert math.isnan(scaling.slope(sizes, [1.0, 1.0, 0.0, 1.0]))
