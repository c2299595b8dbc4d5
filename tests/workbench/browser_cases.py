"""Helpers of tests in a real browser: looks at a page, wide and narrow, light and dark; steps and waits.

Pictures of every step go to the folder that STRUCTID_SCREENS names; without it none are taken.
"""

from __future__ import annotations

from pathlib import Path

LOOKS = ((1400, "light"), (1400, "dark"), (420, "light"), (420, "dark"))
AXE = (Path(__file__).parent / "axe" / "axe.min.js").read_text(encoding="utf-8")


def shown(page, screens: Path | None, name: str) -> None:
    """Nothing is wider than the page, wide and narrow; pictures of both, light and dark, where a folder is for them."""
    for width, scheme in LOOKS if screens else LOOKS[::2]:
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(250)
        assert page.evaluate("document.documentElement.scrollWidth") <= width, (name, width)
        if screens:
            page.screenshot(path=screens / f"{name}_{width}_{scheme}.png", full_page=True)
    page.set_viewport_size({"width": 1400, "height": 900})
    page.emulate_media(color_scheme="light")


def accessible(page, name: str) -> None:
    """No serious finding of axe-core, in either scheme."""
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(100)
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


def eventually(page, holds) -> None:
    """Wait until `holds()`, two minutes at most."""
    for _ in range(1200):
        if holds():
            return
        page.wait_for_timeout(100)
    assert holds()


def step(page, name: str) -> None:
    page.get_by_role("navigation").get_by_role("link", name=name).click()
    page.wait_for_selector(f"[data-step={name.lower().replace('study file', 'text')}]")
