"""The page: complete, self-contained, escaped, the same every time, warnings first."""

from __future__ import annotations

import html
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
import report_cases
from page_parts import figures, unpacked, words
from written_reports import PROVENANCE, TITLE, Report

from structid.core.display import number
from structid.core.errors import FileError
from structid.identification.identified import Identification
from structid.report.identification import report_page, sorted_warnings, write_report
from structid.report.page import plotly_part

_SECTIONS = ("verdict", "values", "fit", "structure", "more")
_FOLDS = ("responses", "modes", "statistics", "residuals", "correlation", "assumed", "convergence", "provenance")


class _Tags(HTMLParser):
    """Every tag of a page with its attributes, and the text between tags."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def _parsed(text: str) -> _Tags:
    parser = _Tags()
    parser.feed(text)
    return parser


def test_page_loads_nothing_from_elsewhere(cantilever: Report) -> None:
    parsed = _parsed(cantilever.page)
    for tag, attributes in parsed.tags:
        assert not {"src", "href", "srcset", "action", "data"} & set(attributes), (tag, attributes)
    assert not {"link", "iframe", "object", "embed", "img"} & {tag for tag, _ in parsed.tags}
    style = cantilever.page.split("<style>")[1].split("</style>")[0]
    assert "url(" not in style
    assert "@import" not in style
    policy = next(a["content"] for t, a in parsed.tags if t == "meta" and a.get("http-equiv"))
    assert policy is not None
    assert "default-src 'none'" in policy
    assert "http" not in policy


def test_library_is_embedded_once_and_whole(cantilever: Report) -> None:
    """That part of it that draws the plane: nothing here is in space."""
    assert unpacked(cantilever.page)["library-plane"] == plotly_part("plotly-cartesian.min.js")
    assert cantilever.page.count('class="library"') == 1


def test_page_is_light(cantilever: Report) -> None:
    """The part of the library is 0.66 MB of it, compressed and in letters."""
    assert len(cantilever.page) < 900_000


def test_no_array_is_embedded_twice(cantilever: Report) -> None:
    arrays = [tuple(row) for row in json.loads(unpacked(cantilever.page)["figures"])["arrays"]]
    long = [row for row in arrays if len(row) > 20]
    assert len(set(long)) == len(long)
    frequency = cantilever.identification.measured.frequency
    assert sum(row == pytest.approx(tuple(frequency), rel=1e-5) for row in long if len(row) == len(frequency)) == 1


def test_page_has_every_section_in_order_and_every_fold_is_closed(series: Report) -> None:
    starts = [f'<section id="{name}"' for name in _SECTIONS] + [f'<details id="{name}">' for name in _FOLDS]
    places = [series.page.index(start) for start in starts]
    assert places == sorted(places)


def test_first_screen_has_verdict_next_step_and_what_is_not_determined(series: Report) -> None:
    first = series.before_scripts.split('<section id="fit"')[0]
    assert "Undetermined: the data do not determine every parameter" in first
    assert "Next:" in first
    assert "not determined" in first
    for direction in series.identification.estimate.identifiability.directions:
        assert html.escape(f"the data determine {direction.words}") in first


def test_every_warning_is_in_the_statistics(series: Report) -> None:
    folded = series.before_scripts.split('<details id="statistics"')[1]
    warnings = sorted_warnings(series.identification)[0]
    assert warnings
    for warning in warnings:
        assert html.escape(warning) in folded


def test_every_warning_of_many_is_on_the_page(many: Identification) -> None:
    assert len(many.warnings) > 10
    text = re.sub("</?code>", "`", words(report_page(many).text))
    for warning in many.warnings:
        assert html.escape(warning) in text


@pytest.mark.parametrize("name", ["cantilever", "series"])
def test_every_parameter_is_in_the_table_escaped(name: str, request: pytest.FixtureRequest) -> None:
    report: Report = request.getfixturevalue(name)
    table = report.before_scripts.split('<section id="values"')[1].split('<section id="fit"')[0]
    for parameter in report.identification.estimate.names:
        assert f"<td>{html.escape(parameter)}</td>" in table


def test_every_stage_of_the_search_is_in_the_table_of_the_convergence(series: Report) -> None:
    search = series.identification.estimate.search
    fold = series.page.split('id="convergence"')[1].split("</details>")[0]
    assert len(search.stages) > 1
    for stage in search.stages:
        assert stage.name in fold
        assert number(float(stage.costs[-1])) in fold


def test_a_window_that_changes_its_size_changes_no_limits_of_a_drawing(series: Report) -> None:
    """Plotly widens limits of equal scales at each resize unless the domain gives way."""
    for panel in json.loads(unpacked(series.page)["figures"])["figures"]["structure"]:
        assert [panel["layout"][axis]["constrain"] for axis in ("xaxis", "yaxis")] == ["domain", "domain"]
        assert panel["layout"]["yaxis"]["scaleanchor"] == "x"


def test_names_and_title_cannot_become_markup(series: Report) -> None:
    assert "<1>" not in series.page
    assert "<b>7</b>" not in series.page
    parsed = _parsed(series.before_scripts)
    assert TITLE in parsed.text
    assert "lower <1>" in parsed.text
    assert "files: <frf>.npz" in parsed.text
    assert PROVENANCE["files"]["<frf>.npz"] in parsed.text  # type: ignore[index]
    assert series.page.count("</script>") == 3
    drawn = unpacked(series.page)["figures"]
    assert "<1>" not in drawn
    assert "lower &lt;1&gt;" in drawn


def test_page_gives_value_std_and_status(series: Report) -> None:
    text = _parsed(series.before_scripts).text
    assert "3.00011 ± 0.00049\u00a0kg" in text  # total mass, seeded noise
    assert "3 of 4" in text
    assert "not identifiable" in text
    assert "1.000 ± not determined" in text  # kN/m


def test_both_standard_deviations_are_given_and_the_adopted_is_named(cantilever: Report) -> None:
    text = _parsed(cantilever.before_scripts).text
    assert "Std (noise)" in text
    assert "Std (model error)" in text
    assert "Identified ± std (noise and tolerances, adopted)" in text
    assert "± includes 1 % of " in text


def test_every_channel_can_be_chosen(cantilever: Report) -> None:
    panels = figures(cantilever.page)["frf"]
    n_lines = len(cantilever.identification.measured.frequency)
    assert len(panels) == 2
    for panel, channel in zip(panels, ("3Y+/6Y+", "6Y+/6Y+"), strict=True):
        assert panel["title"].startswith(f"{channel}: median relative error ")
        assert {len(trace["y"]) for trace in panel["data"]} == {n_lines}
        assert {trace["yaxis"] for trace in panel["data"]} == {"y", "y2", "y3"}
    chooser = cantilever.page.split('id="choice-frf"')[1].split("</select>")[0]
    assert chooser.count("<option ") == 2


def test_lines_outside_the_band_are_shown_as_not_used(cantilever: Report) -> None:
    traces = figures(cantilever.page)["frf"][1]["data"]
    unused, used = (next(t for t in traces if t.get("name") == name) for name in ("measured, not used", "measured"))
    for f, faint, plain in zip(unused["x"], unused["y"], used["y"], strict=True):
        inside = 5.0 <= f <= 150.0 and not 60.0 <= f <= 66.0
        assert (plain is not None) == inside
        assert (faint is not None) == (not inside)


def test_unidentified_elements_are_dashed(series: Report, cantilever: Report) -> None:
    def dashed(report: Report, title: str) -> list[str]:
        panel = next(p for p in figures(report.page)["structure"] if p["title"] == title)
        return [
            t["line"]["color"]
            for t in panel["data"]
            if t.get("name") == "not identified" and t["line"]["dash"] == "dash"
        ]

    assert dashed(series, "Change of stiffness parameters")
    for name in ("stiffness", "mass", "damping"):
        assert not dashed(cantilever, f"Change of {name} parameters")


def test_browsers_that_cannot_unpack_are_told(cantilever: Report) -> None:
    note = cantilever.page.split('id="too-old"')[1].split("</p>")[0]
    assert "--png" in note
    assert "hidden" in note.split(">")[0]
    assert '"DecompressionStream" in window' in cantilever.page


def test_same_input_gives_the_same_bytes(series: Report, tmp_path: Path) -> None:
    write_report(report_cases.springs_in_series(), tmp_path, TITLE, PROVENANCE, png=True)
    first = {p.relative_to(series.folder): p.read_bytes() for p in series.folder.rglob("*") if p.is_file()}
    second = {p.relative_to(tmp_path): p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert first == second


def test_nothing_but_the_report_is_left_in_the_folder(series: Report) -> None:
    names = {str(p.relative_to(series.folder)) for p in series.folder.rglob("*") if p.is_file()}
    assert "report.html" in names
    assert all(n == "report.html" or (n.startswith("figures/") and n.endswith(".png")) for n in names)
    assert not [n for n in names if Path(n).name.startswith(".")]


def test_png_files_are_written_only_when_asked_for(series: Report, tmp_path: Path) -> None:
    path = write_report(series.identification, tmp_path / "new", TITLE, PROVENANCE)
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    assert path.read_text(encoding="utf-8") == series.page


def test_a_page_needs_no_matplotlib() -> None:
    code = "import sys, structid.report.identification; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_folder_that_cannot_be_made_is_named(series: Report, tmp_path: Path) -> None:
    blocked = tmp_path / "taken"
    blocked.write_text("a file")
    with pytest.raises(FileError, match="taken"):
        write_report(series.identification, blocked / "report")
