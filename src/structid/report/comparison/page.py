"""A comparison as a page, as figures and as tables of the terminal."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path

from structid._version import __version__
from structid.comparison.comparing import COMPARE_PAGE, ComparisonResult
from structid.files import made_folder
from structid.report.comparison.figures import comparison_pictures
from structid.report.comparison.text import HEADER, comparison_rows, facts
from structid.report.page_template import page_template


def write_comparison_page(result: ComparisonResult, folder: Path) -> Path:
    """Path of ``compare.html`` in `folder`, written with its PNG files in ``figures``.

    The same comparison gives the same bytes.

    Raises
    ------
    FileError
        If the folder cannot be made.
    """
    pictures = comparison_pictures(result)
    figures = made_folder(Path(folder) / "figures")
    for name, png in pictures.items():
        (figures / f"{name}.png").write_bytes(png)
    path = Path(folder) / COMPARE_PAGE
    path.write_text(comparison_page(result, pictures), encoding="utf-8")
    return path


def comparison_page(result: ComparisonResult, pictures: dict[str, bytes]) -> str:
    """The page as text, with the pictures in it."""
    found = result.comparison
    return page_template("compare.html.j2").render(
        title=f"{result.baseline.title} → {result.later.title}",
        version=__version__,
        complete=found.is_complete,
        any_changed=bool(found.changed.any()),
        words=found.words,
        warnings=result.warnings,
        facts=facts(result)[1:],
        header=HEADER,
        rows=comparison_rows(result),
        pictures={name: f"data:image/png;base64,{b64encode(png).decode('ascii')}" for name, png in pictures.items()},
    )
