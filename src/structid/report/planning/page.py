"""The page of a plan, with its pictures in it."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path

from structid._version import __version__
from structid.files import made_folder
from structid.planning.planned import Plan
from structid.report.page_template import page_template
from structid.report.planning.figures import plan_pictures, write_plan_pictures
from structid.report.planning.text import (
    TEST_HEADER,
    choice_lines,
    enough_lines,
    next_lines,
    options_text,
    parameter_rows,
    test_rows,
)
from structid.study.results.plan import PLAN_PAGE


def write_plan_page(found: Plan, folder: Path, title: str = "", notes: tuple[str, ...] = ()) -> Path:
    """Path of ``plan.html`` in `folder`, written with its PNG files in ``figures``. The same plan gives the same bytes.

    Raises
    ------
    FileError
        If the folder cannot be made.
    """
    pictures = plan_pictures(found)
    write_plan_pictures(pictures, made_folder(Path(folder) / "figures"))
    path = Path(folder) / PLAN_PAGE
    path.write_text(plan_page(found, pictures, title, notes), encoding="utf-8")
    return path


def plan_page(found: Plan, pictures: dict[str, bytes], title: str = "", notes: tuple[str, ...] = ()) -> str:
    """The page as text."""
    header, rows = parameter_rows(found)
    return page_template("plan.html.j2").render(
        title=title or "Structure",
        version=__version__,
        determined=found.determined,
        chosen_determines=found.chosen.determined,
        options=options_text(found),
        lines=[*choice_lines(found), *enough_lines(found), *next_lines(found)],
        notes=notes,
        directions=[d.words for d in found.identifiability.directions],
        groups=[group.words for group in found.identifiability.groups],
        test_header=TEST_HEADER,
        tests=test_rows(found),
        parameter_header=header,
        parameters=rows,
        pictures={name: f"data:image/png;base64,{b64encode(png).decode('ascii')}" for name, png in pictures.items()},
    )
