"""About a minute of `python -m fuzz`, always the same mutants: every file of every kind is read or refused in words."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.fuzz
def test_damaged_files_are_read_or_refused():
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-m", "fuzz", "--count", "1200", "--seed", "7", "--workers", "2"],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    last = next(line for line in done.stdout.splitlines() if line.startswith("all"))
    mutants, read, refused, *others = (int(word) for word in last.split()[1:7])
    assert (mutants, others) == (1200, [0, 0, 0])
    assert read > 100
    assert refused > 400
