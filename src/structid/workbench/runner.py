"""One run of `structid identify` in a process of its own, whose end is written down however it comes.

Called as ``python -m structid.workbench.runner FOLDER WORDS...``; it imports nothing that takes time or memory.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

#: Letters that are kept free for how the run ends, so that a full disk does not swallow it.
_ENDED = 80
#: Bytes below which a disk is full.
_FULL = 1_000_000


def main() -> None:
    """Run the command `WORDS`, its words to ``log.txt`` and its end to ``ended.json`` in `FOLDER`."""
    folder, words = Path(sys.argv[1]), sys.argv[2:]
    (folder / "ended.json").write_text(" " * _ENDED, encoding="utf-8")
    for number in (signal.SIGINT, signal.SIGTERM):  # sent to the whole group: this process waits for the other's end
        signal.signal(number, lambda *_: None)
    with (folder / "log.txt").open("ab") as log:
        child = subprocess.Popen(
            [sys.executable, "-P", "-m", "structid", *words], stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
        (folder / "child.json").write_text(json.dumps({"pid": child.pid}), encoding="utf-8")
        code = child.wait()
    ended = {"code": code, "disk_full": shutil.disk_usage(folder).free < _FULL}
    with (folder / "ended.json").open("r+", encoding="utf-8") as stream:
        stream.write(json.dumps(ended).ljust(_ENDED))


if __name__ == "__main__":
    main()
