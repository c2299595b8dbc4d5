"""PNG files and what the figures show."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
import report_cases
from page_parts import pieces
from written_reports import Report

import structid as si
from structid.dynamics.normal_modes import Modes
from structid.identification.identified import Identification
from structid.report.drawing.drawing import Label, place_without_overlap, structure_picture
from structid.report.drawing.palette import DIVERGING, steps
from structid.report.figures.parameters import correlation_figure, mode_rows, parameters_figure
from structid.report.figures.responses import (
    MAX_CHANNELS,
    channel_unit,
    channels,
    line_edges,
    responses_figure,
    whitened,
    worst_channels,
)
from structid.report.figures.structure import Change, element_style, shading, shadings, structure_figure
from structid.report.identification import write_report
from structid.report.identification_tables import mode_table
from structid.report.rendering.plot import Area, ColourScale, Curve, Panel, Texts
from structid.report.rendering.png import STYLE, drawn, plain

_NAMES = {
    "extremes", "shapes",
    "parameters", "structure", "frf_magnitude", "frf_phase", "residual_by_channel", "residual_map", "correlation",
    "modes", "convergence", "correlation_1_responses_frac", "correlation_1_responses_fdac",
}  # fmt: skip


def _size(path: Path) -> tuple[int, int]:
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", data[16:24])


def _structure(found: Identification) -> tuple[Panel, ...]:
    drawing = structure_picture(found.structure, found.sensors, found.loads)
    return structure_figure(drawing, shadings(found)).panels


def _dashed(panel: Panel) -> list[Curve]:
    named = [trace for trace in panel.traces if trace.label == "not identified" and isinstance(trace, Curve)]
    return [trace for trace in named if trace.pen is not None and trace.pen.dash == "dash"]


def test_png_files_have_their_size_and_something_on_them(cantilever: Report, series: Report) -> None:
    for report, extra in ((cantilever, {"frf_coherence"}), (series, set())):
        files = {p.stem: p for p in (report.folder / "figures").glob("*.png")}
        assert set(files) == _NAMES | extra
        for path in files.values():
            width, height = _size(path)
            assert 900 <= width <= 3200
            assert 350 <= height <= 3200
            assert np.ptp(matplotlib.image.imread(path)[..., :3]) > 0.5
    # 10.5 in and 1.3 in + 13 rows of 0.25 in + a legend of 0.2 in, at 150 dots an inch
    assert _size(cantilever.folder / "figures" / "parameters.png") == (1575, 712)


def test_unidentified_elements_are_dashed(series: Report) -> None:
    mass, stiffness = _structure(series.identification)[:2]
    assert mass.title == "Change of mass parameters"
    assert len(_dashed(mass)) == 0
    edge, lines = _dashed(stiffness)  # the colour lies on a dark line
    assert edge.pen.width > lines.pen.width
    two = next(shading for shading in shadings(series.identification) if "stiffness" in shading.title).changes
    assert sum(not change.identified for change in two.values()) == 2
    assert np.isnan(lines.x).sum() >= 1  # both springs


def test_masses_that_are_not_identified_are_hatched() -> None:
    structure = si.Structure(
        {0: 0.0, 1: 1.0, 2: 2.0},
        [si.PointMass("known", [1], 2.0), si.PointMass("twin", [1], 2.0), si.Spring("k", "0X", "1X", stiffness=1e3)],
        fixed=["0X"],
        active=["X"],
    )
    unknown = si.parameters(structure, [si.Unknown("mass", "known"), si.Unknown("mass", "twin")])
    record = report_cases.synthetic_record(structure, unknown, np.linspace(1, 5, 20), ["1X"], ["1X"], 0.01)
    identification = report_cases.identify(structure, unknown, record)
    hatched = [trace for trace in _structure(identification)[0].traces if isinstance(trace, Area) and trace.hatched]
    assert sum(np.isnan(trace.x).sum() + 1 for trace in hatched) == 2
    with matplotlib.rc_context(STYLE):
        axes = drawn(structure_figure(structure_picture(structure, [], []), shadings(identification))).axes[0]
    assert [c.get_hatch() for c in axes.collections].count("////") == len(hatched)


def test_many_channels_are_capped_and_the_figure_says_so(many: Identification) -> None:
    fit = many.fits[0]
    found = channels(fit)
    assert len(found) == 40
    chosen = worst_channels(fit, MAX_CHANNELS)
    assert set(chosen) == set(np.argsort([-c.median_error for c in found])[:16])
    figure = responses_figure(fit)
    assert len(figure.panels) == 40  # all are on the page
    with matplotlib.rc_context(STYLE):
        picture = drawn(figure.strip(0))
    assert len(picture.axes) == MAX_CHANNELS
    assert [axes.get_title(loc="left") for axes in picture.axes] == [found[i].label for i in chosen]
    assert "16 of 40 channels" in picture.get_supxlabel()


@pytest.mark.parametrize("name", ["plane", "groups"])
def test_odd_models_are_drawn_without_a_warning(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("structid.report.rendering.png.DPI", 40)
    page = write_report(report_cases.CASES[name](), tmp_path, png=True).read_text(encoding="utf-8").split("<script")[0]
    assert ("drawn in a row" in page) == (name == "groups")
    assert ("träger $x$ 梁" in page) == (name == "plane")


def test_text_is_kept_free_of_mathematics_and_missing_glyphs() -> None:
    assert plain("a$b$ ± 梁") == r"a\$b\$ ± □"


def test_colours_are_centred_at_no_change() -> None:
    scale = ColourScale(DIVERGING, -0.2, 0.2, "")
    colours = steps(DIVERGING)
    found = [scale.colour(change) for change in (-0.5, -0.2, 0.0, 0.2, 0.5, np.nan)]
    assert found == [colours[0], colours[0], "#F7F7F7", colours[-1], colours[-1], "#F7F7F7"]  # the middle of PuOr
    assert colours[0] != colours[-1]


def test_colours_are_those_of_matplotlib() -> None:
    """PuOr is linear between its colours, cividis nearly so: largest distance 11 of 255."""
    for name, most in (("PuOr", 3), ("cividis", 11)):
        exact = 255 * matplotlib.colormaps[name](np.linspace(0, 1, 41))[:, :3]
        ours = [[int(text[i : i + 2], 16) for i in (1, 3, 5)] for text in steps(name, 41)]
        assert np.abs(exact - ours).max() <= most


def test_elements_carry_the_change_of_their_parameter(cantilever: Report) -> None:
    shown = {shading.title.split()[2]: shading for shading in shadings(cantilever.identification)}
    assert list(shown) == ["mass", "stiffness", "damping"]
    found = cantilever.identification.estimate
    for e in range(6):
        value = found[f"bending_stiffness[beam:{e + 1}]"][0]
        assert shown["stiffness"].changes["beam", e].ratio == pytest.approx(value / 80.0 - 1, abs=1e-12)
    assert shown["stiffness"].changes["beam", 2].ratio == pytest.approx(-0.25, abs=0.02)  # 1 % noise
    assert shown["stiffness"].scale.high == 0.3
    assert not element_style(shown["stiffness"], "beam", 2).is_doubtful
    assert not element_style(shown["stiffness"], "nothing", 0).is_unknown


def test_drawing_of_the_frame_has_its_sensors_in_their_sense() -> None:
    structure, unknown = report_cases.frame_model()
    outputs = ["1X-", "2X+", "31Z+", "32RY-"]
    record = report_cases.synthetic_record(structure, unknown, np.linspace(5, 9, 30), outputs, ["2X+"], 0.02)
    options = report_cases.IdentifyOptions(method=si.LevenbergMarquardt(max_iterations=1), pole_free_start=False)
    found = report_cases.identify(structure, unknown, record, options)
    drawn = structure_picture(structure, found.sensors, found.loads)
    traces = (*drawn.behind, *drawn.before)
    shafts, tips, heads = {}, {}, {}
    for k, trace in enumerate(traces):
        if isinstance(trace, Curve) and trace.label in ("sensor", "load"):
            shafts[trace.label] = pieces(trace.x, trace.y)
            heads[trace.label] = pieces(traces[k + 1].x, traces[k + 1].y)
            tips[trace.label] = np.column_stack([traces[k + 2].x, traces[k + 2].y])
            dofs = found.sensors if trace.label == "sensor" else found.loads
            assert traces[k + 2].hover == tuple(f"{trace.label} {dof}" for dof in dofs)
    left, right, up, _ = zip(shafts["sensor"], tips["sensor"], strict=True)
    assert left[1][0] < left[0][0, 0]
    assert right[1][0] > right[0][0, 0]
    assert up[1][1] > up[0][0, 1]
    assert up[1][0] == pytest.approx(up[0][0, 0])
    assert len(heads["sensor"]) == 1 + 1 + 1 + 2  # a rotation has two
    at_node = right[0][0]
    assert heads["load"][0][0] == pytest.approx(at_node)
    assert tips["load"][0, 0] < at_node[0]
    assert len(drawn.marks) == 4 + 12 + 12 + 5
    named = {trace.label: trace for trace in traces if trace.label}
    assert len(pieces(named["support"].x, named["support"].y)) == 1
    assert len(pieces(named["rigid link"].x, named["rigid link"].y)) == 16  # 4 of each of 4 plates
    assert next(words.words for words in traces if isinstance(words, Texts)) == ("X", "Y", "Z")


def test_ratios_stay_within_the_axis_and_wild_ones_do_not_stretch_it(many: Identification) -> None:
    panel = parameters_figure(many).panels[0]
    low, high = panel.x.limits
    points = [trace for trace in panel.traces if isinstance(trace, Curve) and trace.marker is not None]
    assert sum(len(trace.x) for trace in points) == len(many.estimate.names)
    assert all(((trace.x >= low) & (trace.x <= high)).all() for trace in points)
    ratio = many.estimate.values / many.estimate.initial
    sure = next(trace for trace in points if trace.label == "identified")
    np.testing.assert_allclose(np.sort(sure.x), np.sort(ratio[many.estimate.identified]))
    (wild,) = [trace for trace in panel.traces if trace.label == "not determined"]
    assert len(wild.x) % 3 == 0
    assert low < np.nanmin(wild.x) < np.nanmax(wild.x) < high


def test_whitened_residual_of_a_fit_to_the_noise_is_about_one(cantilever: Report) -> None:
    fit = cantilever.identification.fits[0]
    frequency, found = whitened(fit)
    used = np.isin(frequency, fit.problem.record.frequency)
    n = 2 * found[used].size
    # mean square of n normal numbers, minus what 13 parameters take up: 5 standard deviations
    assert np.mean(found[used] ** 2) == pytest.approx(1 - 13 / n, abs=5 * np.sqrt(2 / n))
    assert np.isnan(found[~used]).all()


def test_correlation_is_grey_where_it_is_not_determined(series: Report) -> None:
    panel = correlation_figure(series.identification).panels[0]
    (cells,) = panel.traces
    assert panel.background == "#D9D9D9"
    assert np.isnan(cells.values[:2]).all()
    assert np.isnan(cells.values[:, :2]).all()
    assert np.diag(cells.values)[2:] == pytest.approx(1.0)


def test_modes_are_paired_with_their_mac(cantilever: Report) -> None:
    rows = mode_rows(cantilever.identification)
    assert rows.frequency == pytest.approx(cantilever.identification.modes.frequency)
    assert ((rows.mac > 0.9) & (rows.mac <= 1 + 1e-12)).all()


def test_modes_that_change_their_order_stay_together() -> None:
    shapes = np.eye(3)
    initial = Modes(np.array([9.0, 16.0, 25.0]), np.zeros(3), shapes, np.zeros(3))
    modes = Modes(np.array([16.5, 20.0, 25.0]), np.zeros(3), shapes[:, [1, 0, 2]], np.zeros(3))
    rows = mode_rows(SimpleNamespace(modes_initial=initial, modes=modes))  # type: ignore[arg-type]
    assert rows.initial_number.tolist() == [2, 1, 3]
    assert rows.initial_frequency.tolist() == [initial.frequency[k] for k in (1, 0, 2)]
    assert rows.mac.tolist() == [1.0, 1.0, 1.0]
    assert [row[0] for row in mode_table(rows, (0.0, 9.0)).rows] == ["1 (was 2)", "2 (was 1)", "3"]


def test_modes_of_a_rigid_body_keep_their_numbers():
    """Shapes of three modes at 0 Hz that turn into each other, and two elastic ones that cross."""
    shapes = np.eye(5)
    before = SimpleNamespace(frequency=np.array([0, 0, 1e-6, 4.0, 5.0]), mode_shapes=shapes, damping_ratio=np.zeros(5))
    after = SimpleNamespace(
        frequency=np.array([0, 1e-6, 1e-6, 5.0, 6.0]), mode_shapes=shapes[:, [1, 2, 0, 4, 3]], damping_ratio=np.zeros(5)
    )
    rows = mode_rows(SimpleNamespace(modes_initial=before, modes=after))  # type: ignore[arg-type]
    np.testing.assert_array_equal(rows.initial_number, [1, 2, 3, 5, 4])


def test_units_of_rotations_and_moments() -> None:
    sensor, turn = si.Dof(1, "X"), si.Dof(1, "RZ")
    assert channel_unit("accelerance", sensor, sensor) == "(m/s^2)/N"
    assert channel_unit("receptance", turn, sensor) == "rad/N"
    assert channel_unit("mobility", turn, turn) == "(rad/s)/(N m)"


def test_cells_of_the_map_are_centred_on_their_lines() -> None:
    assert line_edges(np.array([1.0, 2.0, 4.0])).tolist() == [0.5, 1.5, 3.0, 5.0]
    assert line_edges(np.array([3.0])).tolist() == [2.5, 3.5]


def test_labels_never_cover_each_other() -> None:
    random = np.random.default_rng(5)
    wanted = [Label("12345", x, np.array([0.0, 1.0]), "node") for x in random.random((60, 2))]
    placed, lost = place_without_overlap(wanted, (0.02, 0.04), 0.02, np.zeros((0, 2)))
    assert len(placed) + lost == 60
    assert placed
    half = 0.5 * np.array([5 * 0.02, 1.25 * 0.04])
    for i, (_, first) in enumerate(placed):
        for _, second in placed[:i]:
            assert (np.abs(first - second) >= 2 * half - 1e-12).any()


def test_a_change_within_its_interval_has_the_colour_of_none() -> None:
    changes = {
        ("k", 0): Change(0.3, True, "", False),
        ("k", 1): Change(0.3, True, ""),
        ("k", 2): Change(0.3, False, "", False),
    }
    shade = shading("stiffness", changes, 0.5)
    none, far = shade.scale.colour(0.0), shade.scale.colour(0.3)
    assert none != far
    assert [element_style(shade, "k", i).colour for i in range(3)] == [none, far, far]
    assert [element_style(shade, "k", i).is_doubtful for i in range(3)] == [False, False, True]


def test_changes_are_significant_where_the_interval_leaves_the_initial_value_out(cantilever: Report) -> None:
    """Elements 3 and 5 have 0.75 and 1.1 times the initial stiffness, noise is 1 %; the others have what they began with."""
    [stiffness] = [own for own in shadings(cantilever.identification) if "stiffness" in own.title]
    told = [stiffness.changes["beam", i].is_significant for i in range(6)]
    assert told[2]
    assert told[4]
    assert sum(told) <= 3
