"""The page, the JSON file, the figures and the command of a reproduction, tried on three small items."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib import image
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.display import DASH, MINUS, TIMES
from structid.core.errors import FileError, InputError
from structid.report.rendering.plot import Area
from structid.report.rendering.plot import Curve as Drawn
from structid.report.reproduce import panels_figure, table_text, write_reproduction
from structid.reproduce import reproduction
from structid.reproduce.reproduction import Curve, Panel, ReproducedItem, Table, Verdict

VERDICTS = {
    "agrees to the printed digits",
    "misprint, with the correction",
    "agrees under this reading",
    "does not hold, with the evidence",
}
PRINTED = [[0.90, 12.0], [1.15, np.nan]]
COMPUTED = [[0.9004, 11.96], [1.15, np.inf]]


def small_items() -> tuple[ReproducedItem, ...]:
    table = Table(("first", "second (N m^2)"), ("mass <kg>", "error (%)"), PRINTED, COMPUTED)
    support = Table(("only",), ("computed",), [[np.nan]], [[-0.00012345678901234]])
    x = np.arange(4.0)
    bands = Curve("noisy $x$", x, 10.0**-x, 10.0 ** -(x + 1), np.array([2.0, 1.0, np.inf, np.inf]))
    gap = Curve("diverged", x, np.array([1.0, np.inf, np.nan, 0.0]))
    panels = (
        Panel("logarithmic", "iteration", "error", (bands, gap), log_y=True),
        Panel("plain", "t (s)", "x (m)", (gap,)),
    )
    return (
        ReproducedItem(
            "Table 9.1", "A table & its <title>", Verdict.MISPRINT, "First.\nSecond, N m^2.", (table, support)
        ),
        ReproducedItem("Figure 9.1", "A figure", Verdict.READING, "A <b>note</b>.", (), panels),
        ReproducedItem("Claim: all", "A claim", Verdict.REFUTED, "No."),
    )


@pytest.fixture
def written(tmp_path) -> Path:
    page = write_reproduction(small_items(), tmp_path / "out", png=True)
    assert page == tmp_path / "out" / "reproduction.html"
    return page.parent


def test_json_has_the_promised_keys_and_is_strict(written):
    def refuse(word):
        raise AssertionError(word)

    document = json.loads((written / "reproduction.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert [entry["item"] for entry in document["items"]] == ["Table 9.1", "Figure 9.1", "Claim: all"]
    for entry in document["items"]:
        assert {"item", "printed", "computed", "max_abs_difference", "verdict", "note"} <= set(entry)
        assert entry["verdict"] in VERDICTS
        assert len(entry["printed"]) == len(entry["computed"]) == len(entry["rows"])
    first, second, third = document["items"]
    assert first["printed"] == [[0.9, 12.0], [1.15, None]]
    assert first["computed"] == [[0.9004, 11.96], [1.15, None]]
    assert first["max_abs_difference"] == pytest.approx(0.04)
    assert first["supporting_tables"][0]["computed"] == [[-0.000123456789]]  # ten digits
    assert second["max_abs_difference"] is None
    assert second["panels"][0]["curves"][0]["high"] == [2.0, 1.0, None, None]
    assert set(second["panels"][0]["curves"][1]) == {"label", "x", "y"}
    assert third["printed"] == []


def test_page_is_self_contained_and_escapes_what_it_shows(written):
    page = (written / "reproduction.html").read_text(encoding="utf-8")
    words = page.split("<script")[0]
    assert not re.search(r"https?:|@import|<link|src=", words)
    assert 'id="figure-figure_9_1"' in words
    assert "default-src 'none'" in page
    assert page.count("A table &amp; its &lt;title&gt;") == 2  # in the summary and above the item
    assert "A &lt;b&gt;note&lt;/b&gt;." in page
    assert "mass &lt;kg&gt;" in page
    assert "<p>Second, N m².</p>" in page
    for verdict in ("misprint, with the correction", "agrees under this reading", "does not hold, with the evidence"):
        assert page.count(verdict) == 3  # among the counts, in the summary, at the item
    anchors = re.findall(r'href="#([^"]+)"', page)
    assert anchors == ["table_9_1", "figure_9_1", "claim_all"]
    assert all(f'<section id="{anchor}"' in page for anchor in anchors)


def test_second_run_gives_the_same_bytes(written, tmp_path):
    again = write_reproduction(small_items(), tmp_path / "again", png=True).parent
    names = sorted(path.relative_to(written) for path in written.rglob("*") if path.is_file())
    assert list(map(str, names)) == ["figures/figure_9_1.png", "reproduction.html", "reproduction.json"]
    for name in names:
        assert (written / name).read_bytes() == (again / name).read_bytes()


def test_other_files_of_the_folder_stay(written):
    (written / "report.html").write_text("an identification")
    write_reproduction(small_items()[:1], written)
    assert (written / "report.html").read_text() == "an identification"
    assert "Figure 9.1" not in (written / "reproduction.html").read_text(encoding="utf-8")


def test_figures_are_drawn(written):
    pixels = image.imread(written / "figures" / "figure_9_1.png")
    assert pixels.shape[1] == 1575
    colours = {tuple(np.round(255 * c).astype(int)) for c in pixels[::3, ::3, :3].reshape(-1, 3)}
    assert (0, 114, 178) in colours  # the first curve
    assert (213, 94, 0) in colours or (214, 95, 1) in colours  # the second one


def test_curves_and_bands_are_those_of_the_panels():
    first, second = panels_figure(small_items()[1].panels).panels
    bands, gap = [trace for trace in first.traces if isinstance(trace, Drawn)]
    assert bands.y.tolist() == [1.0, 0.1, 0.01, 0.001]
    assert np.array_equal(gap.y, [1.0, np.nan, np.nan, np.nan], equal_nan=True)  # no 0 on a logarithmic axis
    (alone,) = second.traces
    assert np.array_equal(alone.y, [1.0, np.nan, np.nan, 0.0], equal_nan=True)
    assert alone.pen.colour == gap.pen.colour  # the same label
    assert (first.strips[0].y.log, second.strips[0].y.log) == (True, False)
    assert bands.label == f"noisy $x$ (median, 5{DASH}95 % band)"
    (band,) = [trace for trace in first.traces if isinstance(trace, Area)]
    assert band.y.max() == 2.0  # an end that is not finite is drawn at the highest value
    assert band.y.min() == pytest.approx(1e-4)


def test_an_axis_of_few_points_over_powers_of_ten_is_logarithmic():
    x = np.array([4.0, 8.0, 64.0, 1024.0])
    (panel,) = panels_figure((Panel("", "m", "error", (Curve("a", x, x),)),)).panels
    assert panel.x.log
    assert panel.x.ticks == ((4.0, "4"), (8.0, "8"), (64.0, "64"), (1024.0, "1024"))


def test_a_plan_has_equal_units_and_a_label_is_told_once():
    x = np.arange(3.0)
    panel = Panel("", "x (m)", "y (m)", (Curve("a", x, x), Curve("b", x, 2 * x)))
    figure = panels_figure((panel, panel))
    assert [trace.label for trace in figure.legend] == ["a", "b"]
    assert all(panel.equal for panel in figure.panels)


def test_cells_have_the_printed_digits_and_two_more():
    text = table_text(small_items()[0].tables[0])
    assert text.groups == (("mass <kg>", 3), ("error (%)", 3))
    assert text.subheadings == ("printed", "computed", "difference") * 2
    assert text.rows == (
        ("first", ("0.90", "0.9004", f"+4.0{TIMES}10⁻⁴", "12", "11.96", f"{MINUS}0.040")),
        ("second (N m²)", ("1.15", "1.1500", "0", f"{DASH}", "∞", f"{DASH}")),
    )


@pytest.mark.parametrize(
    "printed, computed, cells",
    [
        ([0.064455, 2.58], [0.0644553, 2.5799999], [("0.064455", "0.06445530"), ("2.580000", "2.57999990")]),
        ([-38.2, -0.1], [-38.172, -0.0004], [(f"{MINUS}38.2", f"{MINUS}38.172"), (f"{MINUS}0.1", "0.000")]),
        ([6.0, 12.0], [6.0, 12.0], [("6", "6"), ("12", "12")]),
        (
            [5.2e-9, 1.0e-8],
            [5.21e-9, 1.0e-8],
            [(f"5.2{TIMES}10⁻⁹", f"5.210{TIMES}10⁻⁹"), (f"1.0{TIMES}10⁻⁸", f"1.000{TIMES}10⁻⁸")],
        ),
    ],
)
def test_digits_follow_the_printed_column(printed, computed, cells):
    table = Table(("a", "b"), ("c",), np.array([printed]).T, np.array([computed]).T)
    assert [row[:2] for _, row in table_text(table).rows] == cells


def test_a_row_of_many_whole_numbers_stands_upright():
    table = Table(("model",), ("a", "b", "c", "d"), [[1.0, 2.0, 3.0, 4.0]], [[1.0, 2.0, 3.0, 5.0]])
    text = table_text(table)
    assert text.groups == (("model", 3),)
    assert text.rows[3] == ("d", ("4", "5", "+1.0"))


@pytest.fixture
def fake_chapters(monkeypatch):
    """Chapters that are done at once: 3 gives the table, 4 the figure, 5 the claim."""
    table, figure, claim = small_items()

    def module(chapter):
        if chapter not in reproduction.CHAPTERS:
            return original(chapter)

        def items(progress=None):
            if progress is not None:
                progress("half", 0.5)
            return ({3: table, 4: figure, 5: claim}[chapter],)

        return SimpleNamespace(items=items)

    original = reproduction._module
    monkeypatch.setattr(reproduction, "_module", module)


def test_chapters_run_in_order_with_their_progress(fake_chapters):
    seen = []
    found = reproduction.reproduce((5, 3, 3), lambda name, part: seen.append((name, part)))
    assert [item.name for item in found] == ["Table 9.1", "Claim: all"]
    assert seen == [("half", 0.25), ("half", 0.75)]
    assert len(reproduction.reproduce()) == 3
    with pytest.raises(InputError, match="at least one of 3, 4, 5"):
        reproduction.reproduce(())


def invoke(*arguments):
    return CliRunner().invoke(cli.app, ["reproduce", *map(str, arguments)])


def test_command_prints_a_summary_and_is_quiet_otherwise(fake_chapters, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = invoke()
    assert (done.exit_code, done.stderr) == (0, "")
    lines = [line.split() for line in done.stdout.splitlines()]
    assert lines[0][:2] == ["item", "verdict"]
    assert lines[1][:7] == ["Table", "9.1", "misprint,", "with", "the", "correction", "0.04"]
    assert lines[-1] == [str(Path("reproduction") / "reproduction.html")]
    assert sorted(path.name for path in Path("reproduction").iterdir()) == ["reproduction.html", "reproduction.json"]
    one = invoke("--chapter", 4, "--out", "deep/four", "--png")
    assert one.exit_code == 0
    assert "Figure 9.1" in one.stdout
    assert "Table 9.1" not in one.stdout
    assert (tmp_path / "deep" / "four" / "figures" / "figure_9_1.png").is_file()


def test_command_refuses_what_it_cannot_do(fake_chapters, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = invoke("--chapter", 7)
    assert done.exit_code == 2
    assert done.stderr == "error: --chapter must be one of 3, 4, 5, got 7\n"
    (tmp_path / "taken").write_text("mine")
    done = invoke("--out", "taken")
    assert done.exit_code == 2
    assert "taken: is a file" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["taken"]
    with pytest.raises(FileError, match="is a file"):
        write_reproduction(small_items(), tmp_path / "taken")


def test_an_interruption_exits_130_and_leaves_nothing(fake_chapters, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def interrupted(*_arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("structid.reproduce.reproduction.reproduce", interrupted)
    done = invoke()
    assert done.exit_code == 130
    assert "interrupted; nothing was written" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_has_examples():
    text = invoke("--help").stdout
    assert "Examples:" in text
    assert "\n    structid reproduce --chapter 4 --out chapter_4\n" in text


def test_every_chapter_has_its_module():
    for chapter in reproduction.CHAPTERS:
        assert callable(reproduction._module(chapter).items)
