"""The page of a modal identification, with figures that answer to the mouse and shapes that move."""

from __future__ import annotations

from pathlib import Path

from plotly.offline import get_plotlyjs

from structid._version import __version__
from structid.files import atomic_write, made_folder
from structid.modal.survey.survey import MODES_PAGE, ModesResult
from structid.report.identification.page import embedded
from structid.report.modes.figures import mode_pictures
from structid.report.modes.interactive import mode_figures
from structid.report.modes.text import (
    HEADER,
    method_words,
    mode_rows,
    provenance_rows,
    record_words,
    remarks,
    scale_sentence,
    std_sentence,
)
from structid.report.page_template import page_template
from structid.report.text import counted


def write_modes_page(result: ModesResult, folder: Path) -> Path:
    """Path of ``report.html`` in `folder`, written with its PNG files in ``figures``.

    The same result gives the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    figures = made_folder(Path(folder) / "figures")
    for name, content in mode_pictures(result).items():
        (figures / f"{name}.png").write_bytes(content)
    path = Path(folder) / MODES_PAGE
    with atomic_write(path) as temporary:
        temporary.write_text(modes_page(result), encoding="utf-8")
    return path


def modes_page(result: ModesResult) -> str:
    """The page as text."""
    figures = mode_figures(result)
    return page_template("modes.html.j2").render(
        title=result.title,
        version=__version__,
        found=counted(result.modes.n_modes, "mode"),
        doubtful=bool(result.warnings) or any(remarks(result)),
        warnings=result.warnings,
        scale=scale_sentence(result),
        std=std_sentence(result),
        facts=(record_words(result), method_words(result)),
        steps=result.steps,
        header=HEADER,
        rows=mode_rows(result),
        figures=figures,
        titles=figures["shapes"].described()["motion"]["titles"],
        provenance=provenance_rows(result),
        plotly=get_plotlyjs(),
        described=embedded({name: figure.described() for name, figure in figures.items()}),
    )
