"""Some of `make fuzz`, always the same mutants: files of every kind and keys of studies are read or refused in words."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.fuzz
@pytest.mark.parametrize(
    ("module", "options", "mutants", "least_read"),
    [
        ("fuzz", (), 70, 6),
        ("fuzz.keys", (), 40, 0),
        pytest.param("fuzz", ("--workers", "2"), 3000, 250, marks=pytest.mark.long),
        pytest.param("fuzz.keys", (), 600, 10, marks=pytest.mark.long),
    ],
    ids=["files", "keys of studies", "many files", "many keys of studies"],
)
def test_what_is_wrong_is_read_or_refused(module, options, mutants, least_read):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-m", module, "--count", str(mutants), "--seed", "7", *options],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    last = next(line for line in done.stdout.splitlines() if line.startswith("all"))
    count, read, refused, *others = (int(word) for word in last.split()[1:7])
    assert (count, others) == (mutants, [0, 0, 0])
    assert read > least_read
    assert refused > mutants / 3
