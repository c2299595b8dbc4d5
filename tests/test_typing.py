"""Type hints of the public names hold from outside, in strict mode (pyright says the same of `typed_use.py`)."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def checked(cache, *words):
    words = ["--follow-imports=silent", f"--cache-dir={cache}", *map(str, words)]
    return subprocess.run([sys.executable, "-m", "mypy", *words], capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.mark.long
def test_a_users_script_is_accepted_and_a_wrong_one_is_not(tmp_path):
    right = checked(tmp_path / "cache", "--strict", ROOT / "tests" / "typed_use.py")
    assert right.returncode == 0, right.stdout
    wrong = tmp_path / "wrong.py"
    wrong.write_text("import structid as sid\n\nsid.TimeRecord(20.0, [[0.0]], (1,), ('force',))\n")
    told = checked(tmp_path / "cache", "--strict", wrong).stdout
    assert "Dof" in told
    assert "Found 1 error" in told


@pytest.mark.long
def test_the_gallery_asks_results_for_attributes_that_they_have(tmp_path):
    """Scripts are not typed otherwise; a renamed attribute of a result would fail in the build of the site alone."""
    scripts = sorted((ROOT / "examples" / "gallery").glob("*/*.py"))
    stale = tmp_path / "stale.py"
    stale.write_text("import structid as sid\n\ndef old(found: sid.Identification) -> None:\n    found.priors.share\n")
    told = checked(tmp_path / "cache", "--explicit-package-bases", *scripts, stale).stdout
    missing = [line for line in told.splitlines() if re.search(r'error: "\w+" has no attribute', line)]
    assert [line for line in missing if "stale.py" not in line] == []
    assert len(missing) == 1
