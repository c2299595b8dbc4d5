"""One run of `structid identify` in a process of its own, whose end is written down however it comes.

Called as ``python -m structid.app.runner FOLDER WORDS...``; it imports nothing that takes time or memory.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path


def main() -> None:
    """Run the command `WORDS`, its words to ``log.txt`` and its end to ``ended.json`` in `FOLDER`."""
    folder, words = Path(sys.argv[1]), sys.argv[2:]
    for number in (signal.SIGINT, signal.SIGTERM):  # sent to the whole group: this process waits for the other's end
        signal.signal(number, lambda *_: None)
    with (folder / "log.txt").open("ab") as log:
        child = subprocess.Popen(
            [sys.executable, "-m", "structid", *words], stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
        (folder / "child.json").write_text(json.dumps({"pid": child.pid}), encoding="utf-8")
        code = child.wait()
    (folder / "ended.json").write_text(json.dumps({"code": code}), encoding="utf-8")


if __name__ == "__main__":
    main()
