"""Milliseconds to the first page of the workbench beside an empty page of the same server, and megabytes of the idle server.

Run: python benchmarks/workbench.py   (needs playwright and Chromium)
"""

from __future__ import annotations

import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from urllib.parse import urlsplit

import psutil
from playwright.sync_api import Page, sync_playwright

EXAMPLE = Path(__file__).parents[1] / "examples" / "first_structure" / "study.toml"
TIMES = 7


def main() -> None:
    """Print medians, their ratio, and the memory."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(EXAMPLE, folder)
        command = [sys.executable, "-m", "structid", "app", folder, "--no-browser"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as driver:
            assert server.stdout is not None
            address = next(found[0] for line in server.stdout if (found := re.search(r"http\S+", line)))
            page = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"]).new_page()
            root = "{0.scheme}://{0.netloc}/".format(urlsplit(address))
            opened(page, address, "h2:has-text('New study')")  # the first time reads the server's files
            pairs = [
                (opened(page, address, "h2:has-text('New study')"), opened(page, f"{root}nothing", "body"))
                for _ in range(TIMES)
            ]
            memory = psutil.Process(server.pid).memory_info().rss / 1e6
            server.terminate()
    first, empty = (statistics.median(times) for times in zip(*pairs, strict=True))
    print(f"first page {first:.0f} ms, an empty page {empty:.0f} ms, ratio {first / empty:.1f} (medians of {TIMES})")
    print(f"server {memory:.0f} MB")


def opened(page: Page, address: str, until: str) -> float:
    """Milliseconds from the request until the element is shown."""
    page.goto("about:blank")
    page.goto(address)
    page.locator(until).first.wait_for()
    return float(page.evaluate("performance.now()"))


if __name__ == "__main__":
    main()
