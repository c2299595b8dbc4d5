"""PNG figures and the arrays behind them."""

from __future__ import annotations

import struct
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import report_cases
from matplotlib.axes import Axes
from matplotlib.patches import Patch

import structid as si
from conftest import Report
from structid.identification.identified import Identification
from structid.report import write_report
from structid.report.drawing.changes import look
from structid.report.drawing.drawing import picture
from structid.report.drawing.labels import Label, place
from structid.report.drawing.palette import DIVERGING, colours, diverging_step
from structid.report.figures.data import (
    channel_unit,
    correlation,
    line_edges,
    mode_rows,
    parameter_ratios,
    responses,
    worst_channels,
)
from structid.report.figures.png_responses import MAX_CHANNELS, magnitude_figure
from structid.report.figures.png_structure import structure_figure
from structid.report.figures.png_style import STYLE, plain

_NAMES = {
    "parameters", "structure", "frf_magnitude", "frf_phase", "residual_by_channel", "residual_map", "correlation",
    "modes", "convergence",
}  # fmt: skip


def _size(path: Path) -> tuple[int, int]:
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", data[16:24])


def _dashed(axes: Axes) -> list[Patch]:
    return [patch for patch in axes.patches if patch.get_linestyle() not in ("-", "solid")]


def test_png_files_have_their_size_and_something_on_them(cantilever: Report, series: Report) -> None:
    for report, extra in ((cantilever, {"coherence"}), (series, set())):
        files = {p.stem: p for p in (report.folder / "figures").glob("*.png")}
        assert set(files) == _NAMES | extra
        for path in files.values():
            width, height = _size(path)
            assert 900 <= width <= 3200
            assert 350 <= height <= 3200
            assert np.ptp(matplotlib.image.imread(path)[..., :3]) > 0.5
    # 10.5 in and 1.7 in + 13 rows of 0.27 in, at 150 dots an inch
    assert _size(cantilever.folder / "figures" / "parameters.png") == (1575, 781)


def test_unidentified_elements_are_dashed_or_hatched_in_png(series: Report) -> None:
    drawn = picture(series.identification)
    with matplotlib.rc_context(STYLE):
        mass, stiffness = structure_figure(drawn).axes[:2]
    assert mass.get_title(loc="left") == "change of mass parameters"
    assert len(_dashed(mass)) == 0
    assert len(_dashed(stiffness)) == 2


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
    with matplotlib.rc_context(STYLE):
        axes = structure_figure(picture(identification)).axes[0]
    assert [p.get_hatch() for p in axes.patches].count("////") == 2


def test_many_channels_are_capped_and_the_figure_says_so(many: Identification) -> None:
    data = responses(many.fits[0])
    assert len(data.channels) == 40
    chosen = worst_channels(data, MAX_CHANNELS)
    errors = np.array([c.median_error for c in data.channels])
    assert set(chosen) == set(np.argsort(-errors)[:16])
    with matplotlib.rc_context(STYLE):
        figure = magnitude_figure(data)
    assert sum(axes.get_visible() for axes in figure.axes) == MAX_CHANNELS
    assert "16 of 40 channels" in figure.get_supxlabel()


@pytest.mark.parametrize("name", ["plane", "groups"])
def test_odd_models_are_drawn_without_a_warning(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("structid.report.figures.png.DPI", 40)
    page = write_report(report_cases.CASES[name](), tmp_path).read_text(encoding="utf-8").split("<script>")[0]
    assert ("drawn in a row" in page) == (name == "groups")
    assert ("träger $x$ 梁" in page) == (name == "plane")


def test_text_is_kept_free_of_mathematics_and_missing_glyphs() -> None:
    assert plain("a$b$ ± 梁") == r"a\$b\$ ± □"


def test_colours_are_centred_at_no_change() -> None:
    steps = diverging_step(np.array([-0.5, -0.2, 0.0, 0.2, 0.5, np.nan]), 0.2)
    assert steps.tolist() == [0, 0, 10, 20, 20, 10]
    low, middle, high = (colours(DIVERGING)[i] for i in (0, 10, 20))
    assert middle == "#f6f6f7"  # the middle of PuOr
    assert low != high


def test_elements_carry_the_change_of_their_parameter(cantilever: Report) -> None:
    drawn = picture(cantilever.identification)
    panels = {panel.name: panel for panel in drawn.panels}
    assert list(panels) == ["mass", "stiffness", "damping"]
    found = cantilever.identification.estimate
    for e in range(6):
        value = found[f"bending_stiffness[beam:{e + 1}]"][0]
        assert panels["stiffness"].changes["beam", e].ratio == pytest.approx(value / 80.0 - 1, abs=1e-12)
    assert panels["stiffness"].changes["beam", 2].ratio == pytest.approx(-0.25, abs=0.02)  # 1 % noise
    assert panels["stiffness"].limit == 0.3
    assert not look(panels["stiffness"], "beam", 2).is_doubtful
    assert not look(panels["stiffness"], "nothing", 0).is_unknown


def test_drawing_of_the_frame_has_its_sensors_in_their_sense() -> None:
    structure, unknown = report_cases.frame_model()
    outputs = ["1X-", "2X+", "31Z+", "32RY-"]
    record = report_cases.synthetic_record(structure, unknown, np.linspace(5, 9, 30), outputs, ["2X+"], 0.02)
    options = report_cases.IdentifyOptions(method=si.LevenbergMarquardt(max_iterations=1), pole_free_start=False)
    drawn = picture(report_cases.identify(structure, unknown, record, options))
    left, right, up, _ = drawn.sensors
    assert left.tip[0] < left.shaft[0, 0]
    assert right.tip[0] > right.shaft[0, 0]
    assert up.tip[1] > up.shaft[0, 1]
    assert up.tip[0] == pytest.approx(up.shaft[0, 0])
    assert [len(a.heads) for a in drawn.sensors] == [1, 1, 1, 2]
    load = drawn.loads[0]
    at_node = right.shaft[0]
    assert load.heads[0][0] == pytest.approx(at_node)
    assert load.tip[0] < at_node[0]
    assert len(drawn.marks) == 4 + 12 + 12 + 5
    assert len(drawn.supports) == 1
    assert np.isnan(drawn.links).any(axis=1).sum() == 15  # 16 lines of 4 rigid links
    assert [axis for axis, _ in drawn.axes] == ["X", "Y", "Z"]


def test_ratios_stay_within_the_axis_and_wild_ones_do_not_stretch_it(many: Identification) -> None:
    rows = parameter_ratios(many)
    inside = rows.identified & np.isfinite(rows.ratio)
    assert (rows.ratio[inside] >= rows.limits[0]).all()
    assert (rows.ratio[inside] <= rows.limits[1]).all()
    assert ((rows.shown >= rows.limits[0]) & (rows.shown <= rows.limits[1])).all()
    assert rows.is_wild.any()


def test_whitened_residual_of_a_fit_to_the_noise_is_about_one(cantilever: Report) -> None:
    data = responses(cantilever.identification.fits[0])
    whitened = data.whitened[data.used]
    n = 2 * whitened.size
    # mean square of n normal numbers, minus what 13 parameters take up: 5 standard deviations
    assert np.mean(whitened**2) == pytest.approx(1 - 13 / n, abs=5 * np.sqrt(2 / n))
    assert np.isnan(data.whitened[~data.used]).all()


def test_correlation_is_grey_where_it_is_not_determined(series: Report) -> None:
    matrix = correlation(series.identification)
    assert np.isnan(matrix[:2]).all()
    assert np.isnan(matrix[:, :2]).all()
    assert np.diag(matrix)[2:] == pytest.approx(1.0)


def test_modes_are_paired_with_their_mac(cantilever: Report) -> None:
    rows = mode_rows(cantilever.identification)
    assert rows.frequency == pytest.approx(cantilever.identification.modes.frequency)
    assert ((rows.mac > 0.9) & (rows.mac <= 1 + 1e-12)).all()


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
    placed, lost = place(wanted, (0.02, 0.04), 0.02, np.zeros((0, 2)))
    assert len(placed) + lost == 60
    assert placed
    half = 0.5 * np.array([5 * 0.02, 1.25 * 0.04])
    for i, a in enumerate(placed):
        for b in placed[:i]:
            assert (np.abs(a.at - b.at) >= 2 * half - 1e-12).any()
