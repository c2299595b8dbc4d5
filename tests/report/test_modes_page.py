"""The page of `structid modes`: its numbers are those of the result, and it stands alone."""

import re
from dataclasses import replace

import numpy as np
import pytest
from page_parts import as_array, figures, words

from modes_cases import ambient, frfs
from structid.core.display import with_std
from structid.modal import ModalRecord
from structid.modal.survey.survey import ModesOptions, modes_of_file
from structid.records import Geometry, write_record
from structid.report.figures.survey import CHOSEN, CLUSTERED, OUTSIDE, _orbits, mode_labels, mode_scene, pole_kinds
from structid.report.modes import mode_table, modes_page, remarks
from structid.report.rendering.png import pictures
from structid.similarity import mac

NODES = {1: (0.0, 0.0, 1.0), 2: (0.0, 0.0, 2.0), 3: (0.0, 0.5, 3.5), 9: (0.0, 0.0, 0.0)}
GEOMETRY = Geometry(NODES, ((9, 1, 2, 0, 2, 3),))


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("modes") / "tower <&> 1.npz"
    write_record(path, ambient(duration=120.0))
    return replace(modes_of_file(path, ModesOptions("ssi_cov")), geometry=GEOMETRY)


@pytest.fixture(scope="module")
def page(result):
    return modes_page(result).text


@pytest.fixture(scope="module")
def drawn(page):
    return figures(page)


def traces(panel, name):
    return [trace for trace in panel["data"] if trace.get("name") == name]


def test_table_of_the_page_holds_the_modes(result, page):
    rows = re.findall(r"<tr.*?</tr>", page.split('<section id="modes">')[1].split("</section>")[0], re.DOTALL)[1:]
    assert len(rows) == result.modes.n_modes == 3
    for k, row in enumerate(rows):
        cells = re.findall(r"<td[^>]*>(.*?)</td>", row)
        assert cells[0] == str(k + 1)
        assert cells[1] == with_std(float(result.modes.frequency[k]), float(result.std[k]))
        assert cells[2] == with_std(100 * float(result.modes.damping_ratio[k]), 100 * float(result.std[3 + k]))
        assert cells[5] == f"{min(result.identification.probability[k], 0.99):.2f}"
        assert cells[6] == f"{result.identification.clusters[k].size} in {len(result.identification.sweep)} orders"


def test_stabilization_diagram_holds_every_pole_and_marks_those_of_the_modes(result, drawn):
    sweep = result.identification.sweep
    kinds = np.concatenate(pole_kinds(result))
    assert len(kinds) == sum(len(p.poles) for p in sweep)
    members = sum(c.size for c in result.identification.clusters)
    assert np.count_nonzero(kinds >= CLUSTERED) == members
    frequency, ratio = (np.concatenate([getattr(p, name) for p in sweep]) for name in ("frequency", "damping_ratio"))
    np.testing.assert_allclose(np.sort(frequency[kinds == CHOSEN]), result.modes.frequency, rtol=1e-12)
    outside = ratio[kinds == OUTSIDE]
    assert ((outside < -0.01) | (outside > 0.2)).all()
    (panel,) = drawn["stabilization"]
    poles = [trace for trace in panel["data"] if trace["mode"] == "markers"]
    assert sum(len(trace["x"]) for trace in poles) == len(kinds)
    (chosen,) = traces(panel, "the mode itself")
    np.testing.assert_allclose(np.sort(chosen["x"]), result.modes.frequency, rtol=1e-5)
    assert {"x-thin", "diamond"} <= {trace["marker"]["symbol"] for trace in poles}  # told apart without colour
    (line,) = traces(panel, "first singular value")
    assert max(line["y"]) == pytest.approx(result.spectra.values[:, 0].max(), rel=1e-3)
    assert line["yaxis"] == "y2"


def test_auto_mac_is_that_of_the_shapes(result, drawn):
    np.testing.assert_allclose(drawn["automac"][0]["data"][0]["z"], mac(result.modes.mode_shapes), atol=1e-3)


def test_complexity_plot_holds_the_entries_of_the_shapes(result, drawn):
    assert len(drawn["complexity"]) == result.modes.n_modes
    for k, panel in enumerate(drawn["complexity"]):
        (dots,) = [trace for trace in panel["data"] if trace["mode"] == "markers"]
        found = as_array(dots["x"]) + 1j * as_array(dots["y"])
        assert np.abs(found).max() == pytest.approx(1, abs=1e-5)
        assert abs(np.angle(np.sum(found**2))) < 1e-4  # most of it is real
        assert abs(mac(found, result.modes.mode_shapes[:, k]).item() - 1) < 1e-6


def test_moving_points_follow_the_shape_with_the_sense_of_each_sensor(result, drawn):
    scene = mode_scene(result.modes, GEOMETRY)
    motion = scene.motion[:, :3, [axis.label for axis in scene.axes].index("X")]
    signs = np.array([1, -1, 1])
    for k, panel in enumerate(drawn["mode_shapes"]):
        assert mac(motion[k], signs * result.modes.mode_shapes[:, k]).item() == pytest.approx(1, abs=1e-6)
        (moving,) = [trace for trace in panel["data"] if "real" in trace]
        chain = next(iter(scene.measured.values()))
        sway = as_array(moving["real"]) + 1j * as_array(moving["imaginary"])
        for place, point in enumerate(chain):
            if point >= 0:
                np.testing.assert_allclose(sway[:, place], scene.motion[k, point], atol=1e-5)
                np.testing.assert_allclose([moving[a][place] for a in "xyz"[: len(sway)]], scene.rest[point], atol=1e-5)
    assert (scene.motion[:, 3] == 0).all()  # node 9 has no sensor
    assert scene.measured
    assert scene.still
    assert "no sensor" in scene.notes[0]


def test_without_geometry_sensors_stand_in_a_row_and_the_page_says_so(result):
    scene = mode_scene(result.modes, None)
    assert scene.rest[:, 0].tolist() == [0, 1, 2]
    assert "No geometry was given" in scene.notes[0]
    text = modes_page(replace(result, geometry=None)).text
    assert "No geometry was given" in text


def test_a_plane_geometry_is_drawn_flat(result):
    scene = mode_scene(result.modes, Geometry({n: (x, 0.0, z) for n, (x, _, z) in NODES.items()}))
    assert [axis.title for axis in scene.axes] == ["X (m)", "Z (m)"]
    assert scene.rest.shape == (4, 2)


@pytest.mark.parametrize("has_unit", [True, False])
def test_positions_of_a_file_without_a_unit_of_length_are_said(result, has_unit):
    scene = mode_scene(result.modes, replace(GEOMETRY, has_unit=has_unit))
    assert any("says no unit of length" in note for note in scene.notes) != has_unit


def test_page_says_what_output_only_data_cannot_tell(page):
    assert "output-only data give frequencies, damping ratios and mode shapes of arbitrary scale" in page
    assert "no masses or stiffnesses" in page


def test_page_stands_alone_escapes_the_name_and_is_light(page):
    assert "tower &lt;&amp;&gt; 1.npz" in page
    assert "tower <&>" not in page
    assert len(page) < 2_100_000  # of which the library has 1.9
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", page)


def test_the_same_result_gives_the_same_bytes_and_every_picture(result, tmp_path):
    path = modes_page(result).write(tmp_path, png=True)
    assert path.read_text(encoding="utf-8") == modes_page(result).text
    names = {p.stem for p in (tmp_path / "figures").iterdir()}
    assert names == {"stabilization", "singular_values", "damping", "automac", "complexity", "mode_shapes"}


def test_doubtful_modes_get_a_remark(result):
    modes = result.modes
    shapes = np.array(modes.mode_shapes)
    shapes[:, 1] = [1.0, 1j, -0.5]
    shapes[:, 2] = shapes[:, 0]
    ratio = np.array([modes.damping_ratio[0], -0.001, 0.0005])
    covariance = np.diag([1e-6, 1e-6, 1e-6, 1e-12, 1e-12, 1e-2])
    changed = ModalRecord(modes.frequency, ratio, shapes, modes.channels, covariance)
    identification = replace(result.identification, modes=changed)
    doubtful = replace(result, identification=identification, kurtosis=np.array([np.nan, 3.1, 1.52]))
    first, second, third = ["; ".join(words) for words in remarks(doubtful)]
    assert first == "at the sensors the shape is that of mode 3"
    assert "damping is not positive" in second
    assert "complex shape" in second
    assert "damping is not significantly different from 0" in third
    assert "steady tone" in third
    sure = replace(modes, covariance=np.diag([1e-6] * 3 + [1e-8] * 3))
    good = replace(result, identification=replace(result.identification, modes=sure))
    assert remarks(good) == [[], [], []]
    assert [row[-1] for row in mode_table(good).rows] == ["", "", ""]


def test_methods_without_orders_or_damping_leave_their_figures_out(result):
    modes = replace(result.modes, damping_ratio=np.full(3, np.nan), covariance=None, shape_std=None, changes=None)
    bare = replace(result, identification=replace(result.identification, modes=modes, sweep=(), clusters=()))
    found = modes_page(bare)
    assert set(pictures(found.figures)) == {"singular_values", "automac", "complexity", "mode_shapes"}
    text = words(found.text)
    assert "Stabilization diagram" not in text
    assert "This method gives no standard deviations" in text
    assert "±" not in re.search(r'<section id="modes">.*?</table>', text, re.DOTALL)[0]


def test_frfs_are_drawn_with_their_singular_values(tmp_path):
    write_record(tmp_path / "frf.npz", frfs())
    found = modes_of_file(tmp_path / "frf.npz", ModesOptions(orders=(6, 8, 10, 12)))
    np.testing.assert_allclose(found.spectra.values[:, 0], np.linalg.norm(found.record.values, axis=(1, 2)), rtol=1e-12)
    assert found.spectra.unit == "(m/s^2)/N"
    assert "modal mass of 1 kg" in modes_page(found).text


def test_numbers_of_neighbours_share_a_place(result):
    modes = replace(result.modes, frequency=np.array([2.0, 2.01, 6.0]))
    close = replace(result, identification=replace(result.identification, modes=modes))
    assert [text for _, text in mode_labels(close)] == ["1,2", "3"]


def test_points_that_move_on_ellipses_are_drawn_with_their_paths():
    """Node 1 runs through a circle in mode 2, at 90 degrees between X and Y; mode 1 moves to and fro."""
    shapes = np.array([[1.0, 1.0], [0.5, 1.0j], [0.2, 0.1]])
    modes = ModalRecord([1.0, 2.0], [0.01, 0.01], shapes, ["1X", "1Y", "2X"])
    scene = mode_scene(modes, Geometry({1: (0.0, 0.0, 0.0), 2: (1.0, 0.0, 0.0), 3: (0.0, 0.0, 1.0)}))
    assert _orbits(scene, 0) is None
    path = _orbits(scene, 1)
    first = slice(0, np.flatnonzero(np.isnan(path.x))[0])
    radius = np.hypot(path.x[first], path.y[first])
    np.testing.assert_allclose(radius, np.abs(scene.motion[1, 0, 0]), rtol=1e-9)
    np.testing.assert_allclose(path.z[first], 0.0, atol=1e-12)


def test_sensors_whose_motion_is_unknown_stand_still_and_are_named():
    shapes = np.array([[1.0, 1.0], [0.5, np.nan]])
    scene = mode_scene(ModalRecord([1.0, 2.0], [0.01, 0.01], shapes, ["1X", "2X"]), None)
    assert scene.motion[1, 1, 1] == 0.0
    assert "unknown" in scene.notes[-1]
