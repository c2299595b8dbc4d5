"""Type hints of the public names hold from outside, in strict mode (pyright says the same of this file)."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def checked(path, cache):
    words = ["--strict", "--follow-imports=silent", f"--cache-dir={cache}", str(path)]
    return subprocess.run([sys.executable, "-m", "mypy", *words], capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.mark.long
def test_a_users_script_is_accepted_and_a_wrong_one_is_not(tmp_path):
    right = checked(ROOT / "tests" / "typed_use.py", tmp_path / "cache")
    assert right.returncode == 0, right.stdout
    wrong = tmp_path / "wrong.py"
    wrong.write_text("import structid as sid\n\nsid.TimeRecord(20.0, [[0.0]], (1,), ('force',))\n")
    told = checked(wrong, tmp_path / "cache").stdout
    assert "Dof" in told
    assert "Found 1 error" in told
