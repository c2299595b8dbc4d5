"""`python benchmarks/first_hour.py`: how long the demo's answer is, on the console and on its page, and whether all can read it.

Prints the lines on a console of 120 and of 80 columns, the words of the page before its folds, and what axe-core calls
serious at two widths in light and dark. `--pictures FOLDER` keeps a picture of each.
`--results FOLDER` takes results that are there.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import termios
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).parents[1]
AXE = ROOT / "tests" / "workbench" / "axe" / "axe.min.js"
STUDY = ROOT / "examples" / "three_storey_frame" / "study.toml"
WIDTHS, SCHEMES = (1400, 420), ("light", "dark")
COLUMNS = (120, 80)
#: Lines at the wider of them.
MOST_LINES = 22
#: What colours a line.
_STYLES = re.compile(r"\x1b\[[0-9;]*m")
#: Words that are seen, without those of figures and of what is folded.
_WORDS = """() => {
  const seen = document.body.cloneNode(true);
  seen.querySelectorAll("details > :not(summary), script, style, .plot, [hidden], noscript").forEach((part) => part.remove());
  return seen.textContent.split(/\\s+/).filter(Boolean).length;
}"""


def main() -> int:
    """Print the figures; 1 where one misses its bar."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, help="results of the demo, in place of a run")
    parser.add_argument("--pictures", type=Path, help="a folder for pictures of the page")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = arguments.results or Path(folder) / "results" / "demo"
        n_lines = 0
        if arguments.results is None:
            n_lines, n_narrow = (console_lines(Path(folder), columns) for columns in COLUMNS)
            print(f"lines on the console, {COLUMNS[0]} columns wide: {n_lines} (at most {MOST_LINES})")
            print(f"lines on the console, {COLUMNS[1]} columns wide: {n_narrow}")
        n_words, wrong = looked_at(out / "report.html", arguments.pictures)
    print(f"words of the page before its folds: {n_words} (at most 900)")
    print(f"serious findings of axe-core at {WIDTHS} px, light and dark: {len(wrong)} (0)", *wrong, sep="\n  ")
    return int(n_lines > MOST_LINES or n_words > 900 or bool(wrong))


def console_lines(folder: Path, columns: int) -> int:
    """Lines that `structid identify` prints of the demo in a terminal of that width, without those of its progress."""
    command = [sys.executable, "-m", "structid", "identify", str(STUDY), "--out", "results/demo"]
    reader, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 60, columns, 0, 0))
    running = subprocess.Popen(command, stdout=terminal, stderr=subprocess.PIPE, cwd=folder, env={**os.environ})
    os.close(terminal)
    shown = b"".join(iter(lambda: _read(reader), b"")).decode()
    if running.wait():
        raise SystemExit(running.stderr.read().decode())
    print(shown)
    return sum(-(-max(len(_STYLES.sub("", line)), 1) // columns) for line in shown.splitlines())


def _read(reader: int) -> bytes:
    """The next bytes of a terminal; b"" once its program has ended."""
    try:
        return os.read(reader, 65536)
    except OSError:
        return b""


def looked_at(path: Path, pictures: Path | None) -> tuple[int, list[str]]:
    """Words of a page before its folds, and what axe-core calls serious in it."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    wrong: list[str] = []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        page = browser.new_page()
        page.add_init_script(path=AXE)
        page.goto(path.resolve().as_uri())
        n_words = page.evaluate(_WORDS)
        for width in WIDTHS:
            for scheme in SCHEMES:
                wrong.extend(serious(page, width, scheme, pictures))
        browser.close()
    return n_words, wrong


def serious(page: Page, width: int, scheme: str, pictures: Path | None) -> list[str]:
    """Serious and critical findings at one width in one colour scheme, every fold open."""
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    page.reload()
    for is_open in (False, True):
        page.evaluate("(open) => document.querySelectorAll('details').forEach((one) => { one.open = open; })", is_open)
        page.wait_for_timeout(1500)
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            page.screenshot(path=pictures / f"{width}_{scheme}{'_open' if is_open else ''}.png", full_page=True)
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [
        f"{width} px, {scheme}: {one['id']}, {len(one['nodes'])} times, first {one['nodes'][0]['html'][:150]}"
        for one in found
        if one["impact"] in ("serious", "critical")
    ]


if __name__ == "__main__":
    sys.exit(main())
