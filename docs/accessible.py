"""axe-core over a page of each kind of the built site, in light and dark, and its search.

`python docs/accessible.py docs/_build/html`: exit code 1 where anything is serious or critical, a word is not found, or a
page is wider than a telephone. Without a browser nothing is checked, and it says so.
"""

from __future__ import annotations

import functools
import http.server
import shutil
import sys
import threading
from pathlib import Path

AXE = Path(__file__).parents[1] / "tests" / "workbench" / "axe" / "axe.min.js"
PAGES = (
    "index.html",
    "first-bridge.html",
    "how-do-i.html",
    "study-file.html",
    "uncertainty.html",
    "compare.html",
    "api.html",
    "reference/names/structid.Beam.html",
    "reference/commands.html",
    "reference/study-keys.html",
    "gallery/index.html",
    "gallery/commands/identify.html",
    "genindex.html",
    "search.html?q=coherence",
)
#: Words that the search must find.
WORDS = ("coherence", "support", "CSV", "MAC", "identifiable")
#: Colours that fade in have no contrast yet where a machine is busy.
AT_ONCE = "*, *::before, *::after { transition: none !important; animation: none !important }"
RUN = "axe.run(document, {resultTypes: ['violations']})"


def main(site: Path) -> int:
    """Print what is wrong with `site`; the exit code."""
    try:
        from playwright.sync_api import sync_playwright  # in extra `dev`
    except ImportError:
        print("pages not checked: the browser's driver is missing: pip install playwright")
        return 0
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        print("pages not checked: no chromium is installed: apt-get install chromium")
        return 0
    handler = functools.partial(Quiet, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, sync_playwright() as driver:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        wrong = list(found(page, f"http://127.0.0.1:{server.server_address[1]}/"))
        browser.close()
        server.shutdown()
    print("\n".join(wrong) or f"{len(PAGES)} pages in light and dark: nothing serious; search finds {', '.join(WORDS)}")
    return int(bool(wrong))


def found(page, address: str):
    """What is wrong, a line each."""
    page.add_init_script(path=AXE)
    for name in PAGES:
        page.set_viewport_size({"width": 1400, "height": 900})
        answer = page.goto(address + name)
        if answer is None or not answer.ok:
            yield f"{name}: is not there"
            continue
        page.add_style_tag(content=AT_ONCE)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            page.wait_for_timeout(200)
            for one in page.evaluate(RUN)["violations"]:
                if one["impact"] in ("serious", "critical"):
                    yield f"{name}, {scheme}: {one['id']}, {len(one['nodes'])} times, first {one['nodes'][0]['html'][:200]}"
        page.set_viewport_size({"width": 420, "height": 900})
        page.wait_for_timeout(100)
        width = page.evaluate("document.documentElement.scrollWidth")
        if width > 420:
            yield f"{name}: {width} px wide on a telephone of 420"
    for word in WORDS:
        page.goto(f"{address}search.html?q={word}")
        page.wait_for_function("/found|did not match/.test(document.querySelector('#search-results').textContent)")
        if page.locator("#search-results li").count() < 2:
            yield f"search does not find {word!r}"


class Quiet(http.server.SimpleHTTPRequestHandler):
    """A server without a log."""

    def log_message(self, *_: object) -> None:
        """Nothing."""


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
