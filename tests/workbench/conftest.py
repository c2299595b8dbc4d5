"""A real browser for the tests of the workbench's page; they are skipped where there is none."""

from __future__ import annotations

import gc
import os
import re
import shutil
from pathlib import Path

import pytest

#: Answers of the server arrive late, by up to so many seconds: no test may pass only where they come at once.
SLOW_SERVER = """{
  const seconds = %g, ask = window.fetch, wait = () => new Promise((done) => setTimeout(done, 1000 * seconds * Math.random()));
  window.fetch = async (...given) => { await wait(); const answer = await ask(...given); await wait(); return answer; };
}"""


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="the browser's driver is missing: pip install playwright"
    )
    chromium = next(
        (path for path in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if path), None
    )
    if chromium is None:
        pytest.skip("no chromium is installed: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        made = driver.chromium.launch(
            executable_path=chromium,
            args=["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        yield made
        made.close()
    gc.collect()  # here, where what the driver leaves open is no error, and not during another test


@pytest.fixture
def page(browser):
    """A page whose errors fail the test."""
    context = browser.new_context(viewport={"width": 1400, "height": 900}, accept_downloads=True)
    if os.environ.get("STRUCTID_SLOW_SERVER"):
        context.add_init_script(SLOW_SERVER % float(os.environ["STRUCTID_SLOW_SERVER"]))
    made = context.new_page()
    made.set_default_timeout(300_000)
    wrong: list[str] = []
    made.on("pageerror", lambda error: wrong.append(str(error)))
    made.on(
        "console",
        lambda line: (
            wrong.append(line.text)
            if line.type == "error" and not re.search("status of 4|net::ERR", line.text)
            else None
        ),
    )
    yield made
    context.close()
    assert not wrong


@pytest.fixture(scope="module")
def screens():
    if not os.environ.get("STRUCTID_SCREENS"):
        return None
    folder = Path(os.environ["STRUCTID_SCREENS"])
    folder.mkdir(parents=True, exist_ok=True)
    return folder
