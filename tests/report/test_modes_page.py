"""The page of `structid modes`: its numbers are those of the result, and it stands alone."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from modes_cases import ambient, frfs
from structid.modal import ModalRecord
from structid.modal.survey.survey import ModesOptions, modes_of_file
from structid.records import Geometry, write_record
from structid.report.modes.data import CHOSEN, CLUSTERED, OUTSIDE, mode_labels, sweep_poles, turned_shapes
from structid.report.modes.figures import mode_pictures
from structid.report.modes.page import modes_page, write_modes_page
from structid.report.modes.scene import flat, mode_scene
from structid.report.modes.text import mode_rows, remarks
from structid.report.text import with_std
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
    return modes_page(result)


@pytest.fixture(scope="module")
def figures(page):
    text = page.split("const FIGURES = ")[1].split(";\nconst CONFIG")[0]
    return json.loads(text)


def traces(figure, name):
    return [trace for trace in figure["data"] if trace.get("name") == name]


def test_table_of_the_page_holds_the_modes(result, page):
    rows = re.findall(r"<tr.*?</tr>", page.split('<section id="modes">')[1].split("</section>")[0], re.DOTALL)[1:]
    assert len(rows) == result.modes.n_modes == 3
    for k, row in enumerate(rows):
        cells = re.findall(r"<td[^>]*>(.*?)</td>", row)
        assert cells[0] == str(k + 1)
        assert cells[1] == with_std(float(result.modes.frequency[k]), float(result.std[k]))
        assert cells[2] == with_std(100 * float(result.modes.damping_ratio[k]), 100 * float(result.std[3 + k]))
        assert cells[4] == f"{result.identification.clusters[k].size} in {len(result.identification.sweep)} orders"


def test_stabilization_diagram_holds_every_pole_and_marks_those_of_the_modes(result, figures):
    sweep = result.identification.sweep
    poles = sweep_poles(result)
    assert len(poles.frequency) == sum(len(p.poles) for p in sweep)
    members = sum(c.size for c in result.identification.clusters)
    assert np.count_nonzero(poles.kind >= CLUSTERED) == members
    np.testing.assert_allclose(np.sort(poles.frequency[poles.kind == CHOSEN]), result.modes.frequency, rtol=1e-12)
    ratio = poles.damping_ratio[poles.kind == OUTSIDE]
    assert ((ratio < -0.01) | (ratio > 0.2)).all()
    figure = figures["stabilization"]
    drawn = sum(len(trace["x"]) for trace in figure["data"] if trace["mode"] == "markers")
    assert drawn == len(poles.frequency)
    (chosen,) = traces(figure, "the mode itself")
    np.testing.assert_allclose(np.sort(chosen["x"]), result.modes.frequency, rtol=1e-5)
    symbols = [trace["marker"]["symbol"] for trace in figure["data"] if trace["mode"] == "markers"]
    assert {"x-thin", "diamond"} <= set(symbols)  # told apart without colour
    (line,) = traces(figure, "first singular value")
    assert max(line["y"]) == pytest.approx(result.spectra.values[:, 0].max(), rel=1e-3)


def test_auto_mac_is_that_of_the_shapes(result, figures):
    np.testing.assert_allclose(figures["automac"]["data"][0]["z"], mac(result.modes.mode_shapes), atol=1e-3)


def test_complexity_plot_holds_the_entries_of_the_shapes(result, figures):
    turned = turned_shapes(result)
    dots = [trace for trace in figures["complexity"]["data"] if trace["mode"] == "markers"]
    for k, trace in enumerate(dots):
        found = np.array(trace["r"]) * np.exp(1j * np.radians(trace["theta"]))
        np.testing.assert_allclose(found, turned[:, k], atol=2e-4)
        assert abs(mac(found, result.modes.mode_shapes[:, k]).item() - 1) < 1e-6
    assert len(dots) == result.modes.n_modes


def test_moving_points_follow_the_shape_with_the_sense_of_each_sensor(result, figures):
    motion = figures["shapes"]["motion"]
    scene = mode_scene(result.modes, GEOMETRY)
    real, imaginary = np.array(motion["real"]), np.array(motion["imaginary"])
    x = (real + 1j * imaginary)[:, :3, scene.axes.index("X (m)")]
    signs = np.array([1, -1, 1])
    for k in range(result.modes.n_modes):
        assert mac(x[k], signs * result.modes.mode_shapes[:, k]).item() == pytest.approx(1, abs=1e-6)
    assert (real[:, 3] == 0).all()  # node 9 has no sensor
    assert (imaginary[:, 3] == 0).all()
    np.testing.assert_allclose(scene.at(1, np.pi) + scene.at(1, 0.0), 2 * scene.rest, atol=1e-12)
    assert [path.is_measured for path in scene.paths] == [True, False]
    assert "no sensor" in scene.notes[0]
    first = figures["shapes"]["data"][motion["first"]]
    chain = scene.paths[0].points
    np.testing.assert_allclose(first["x"][0], scene.at(0, 0.0)[chain[0], 0], rtol=1e-3)


def test_without_geometry_sensors_stand_in_a_row_and_the_page_says_so(result):
    scene = mode_scene(result.modes, None)
    assert scene.is_row
    assert scene.rest[:, 0].tolist() == [0, 1, 2]
    assert "No geometry was given" in scene.notes[0]
    text = modes_page(replace(result, geometry=None))
    assert "No geometry was given" in text


def test_a_plane_geometry_is_drawn_flat(result):
    scene = mode_scene(result.modes, Geometry({n: (x, 0.0, z) for n, (x, _, z) in NODES.items()}))
    assert scene.axes == ("X (m)", "Z (m)")
    assert flat(scene.rest) is scene.rest


def test_page_says_what_output_only_data_cannot_tell(page):
    assert "output-only data give frequencies, damping ratios and mode shapes of arbitrary scale" in page
    assert "no masses or stiffnesses" in page


def test_page_stands_alone_escapes_the_name_and_is_light(page):
    assert "tower &lt;&amp;&gt; 1.npz" in page
    assert "tower <&>" not in page
    rest = page.replace(get_plotlyjs(), "")
    assert len(rest) < 300_000
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", rest)


def test_the_same_result_gives_the_same_bytes_and_every_picture(result, tmp_path):
    path = write_modes_page(result, tmp_path)
    assert path.read_text(encoding="utf-8") == modes_page(result)
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
    assert "not told apart from 0" in third
    assert "steady tone" in third
    sure = replace(modes, covariance=np.diag([1e-6] * 3 + [1e-8] * 3))
    good = replace(result, identification=replace(result.identification, modes=sure))
    assert remarks(good) == [[], [], []]
    assert [row[-1] for row in mode_rows(good)] == ["", "", ""]


def test_methods_without_orders_or_damping_leave_their_figures_out(result):
    modes = replace(result.modes, damping_ratio=np.full(3, np.nan), covariance=None)
    bare = replace(result, identification=replace(result.identification, modes=modes, sweep=(), clusters=()))
    assert set(mode_pictures(bare)) == {"singular_values", "automac", "complexity", "mode_shapes"}
    text = modes_page(bare)
    assert "Stabilization diagram" not in text
    assert "This method gives no standard deviations" in text
    assert "±" not in re.search(r'<section id="modes">.*?</table>', text, re.DOTALL)[0]


def test_frfs_are_drawn_with_their_singular_values(tmp_path):
    write_record(tmp_path / "frf.npz", frfs())
    found = modes_of_file(tmp_path / "frf.npz", ModesOptions(orders=(6, 8, 10, 12)))
    np.testing.assert_allclose(found.spectra.values[:, 0], np.linalg.norm(found.record.values, axis=(1, 2)), rtol=1e-12)
    assert found.spectra.unit == "(m/s^2)/N"
    assert "modal mass of 1 kg" in modes_page(found)


def test_numbers_of_neighbours_share_a_place(result):
    modes = replace(result.modes, frequency=np.array([2.0, 2.01, 6.0]))
    close = replace(result, identification=replace(result.identification, modes=modes))
    assert [text for _, text in mode_labels(close)] == ["1,2", "3"]
