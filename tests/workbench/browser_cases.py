"""Helpers of tests in a real browser: looks at a page, wide and narrow, light and dark; steps and waits.

Pictures of every step go to the folder that STRUCTID_SCREENS names; without it none are taken.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

LOOKS = ((1400, "light"), (1400, "dark"), (420, "light"), (420, "dark"))
AXE = (Path(__file__).parent / "axe" / "axe.min.js").read_text(encoding="utf-8")


def shown(page, screens: Path | None, name: str) -> None:
    """Nothing is wider than the page, wide and narrow; pictures of both, light and dark, where a folder is for them."""
    for width, scheme in LOOKS if screens else LOOKS[::2]:
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        frames(page)
        page.wait_for_function("width => document.documentElement.scrollWidth <= width", arg=width)
        if screens:
            page.wait_for_timeout(250)
            page.screenshot(path=screens / f"{name}_{width}_{scheme}.png", full_page=True)
    page.set_viewport_size({"width": 1400, "height": 900})
    page.emulate_media(color_scheme="light")


def accessible(page, name: str) -> None:
    """No serious finding of axe-core, in either scheme."""
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        frames(page)
        if not page.evaluate("'axe' in window"):
            page.evaluate(AXE + "; undefined")
        found = page.evaluate(
            "axe.run(document, {exclude: [['iframe']], resultTypes: ['violations'], iframes: false})".replace(
                "document, {exclude: [['iframe']],", "{exclude: [['iframe'], ['.js-plotly-plot']]}, {"
            )
        )
        grave = [
            (one["id"], one["nodes"][0]["html"][:160])
            for one in found["violations"]
            if one["impact"] in ("serious", "critical")
        ]
        assert not grave, (name, scheme, grave)
    page.emulate_media(color_scheme="light")


def frames(page) -> None:
    """Wait until the browser has drawn what was asked of it: two frames."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done())))")


def drawn(page, study: Path) -> None:
    """Wait until the page shows the study as its file stands, whole."""
    digest = hashlib.sha256(study.read_bytes()).hexdigest()
    page.wait_for_selector(f'main[data-drawn="{digest}"]:not([aria-busy])', state="attached")


def write_by_hand(page, study: Path, text: str) -> None:
    """Write the study as another program does, and wait until the page shows it."""
    replace_file(study, text)
    drawn(page, study)


def replace_file(path: Path, text: str) -> None:
    """Write a file in one go: nobody reads it half written."""
    new = path.with_suffix(".new")
    new.write_text(text, encoding="utf-8")
    new.replace(path)


def eventually(page, holds) -> None:
    """Wait until `holds()`, five minutes at most."""
    for _ in range(3000):
        if holds():
            return
        page.wait_for_timeout(100)
    assert holds()


def step(page, name: str) -> None:
    page.get_by_role("navigation").get_by_role("link", name=name).click()
    page.wait_for_selector(f"[data-step={name.lower().replace('study file', 'text')}]")
