"""`python -m fuzz.dist_check FOLDER`: installs the wheel in FOLDER in a clean environment, and runs an example.

`python -m build` makes the sdist, and the wheel from the sdist: what either forgets is missing here.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

EXAMPLE = Path(__file__).parent.parent / "examples" / "ambient_storeys"


def main() -> int:
    """Install, run, and read the answer."""
    packages = sorted(Path(sys.argv[1]).resolve().glob("structid-*.whl"))
    if len(packages) != 1:
        raise SystemExit(f"{sys.argv[1]} must hold one wheel, got {[path.name for path in packages]}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "env", with_pip=True)
        subprocess.run(
            [folder / "env" / "bin" / "python", "-m", "pip", "install", "--quiet", packages[0]], check=True, cwd=folder
        )
        shutil.copytree(EXAMPLE, folder / "example")
        words = ["identify", "example/study.toml", "--out", "results"]
        subprocess.run(
            [folder / "env" / "bin" / "structid", *words], check=False, cwd=folder, stdout=subprocess.DEVNULL
        )
        found = json.loads((folder / "results" / "estimate.json").read_text(encoding="utf-8"))
        page = (folder / "results" / "report.html").stat().st_size
    print(f"{packages[0].name}: {found['status']}, {found['n_parameters']} parameters, a report of {page / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
