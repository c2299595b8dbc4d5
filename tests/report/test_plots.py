"""Figures as methods: each draws what its page shows, on axes of one's own where asked."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from report_cases import cantilever

from modes_cases import ambient
from structid.core.errors import InputError
from structid.modal.survey.survey import ModesOptions, modes_of_file
from structid.records import write_record


@pytest.fixture(scope="module")
def found():
    return cantilever(60)


def pieces(axes):
    return len(axes.lines) + len(axes.collections)


@pytest.mark.parametrize("name", ["parameters", "residuals", "modes", "structure", "correlation", "convergence"])
def test_every_plot_is_a_figure_that_notebooks_show(found, name):
    mpl.get_backend()  # chosen when it is first asked for
    before = mpl.rcParams.copy()
    picture = getattr(found, f"plot_{name}")()
    assert isinstance(picture, Figure)
    assert pieces(picture.axes[0]) > 0
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert mpl.rcParams == before


def test_frf_shows_the_channel_that_is_asked_for(found):
    fit = found.fits[0]
    sensor, load = fit.measured.outputs[-1], fit.measured.inputs[0]
    magnitude, *below = found.plot_frf(sensor.place, load.place).axes
    assert f"{sensor}/{load}" in magnitude.get_title(loc="left")
    assert all(axes.get_title(loc="left") == "" for axes in below)
    drawn = [line.get_ydata() for line in magnitude.lines]
    wanted = np.abs(fit.predicted[:, -1, 0])
    assert any(len(y) >= len(wanted) and np.isin(wanted, np.asarray(y)).all() for y in drawn)
    assert below[-1].get_xlabel() == "frequency (Hz)"
    assert magnitude.get_xlabel() == ""


def test_frf_without_a_channel_is_the_worst(found):
    errors = np.median(found.fits[0].relative_error, axis=0).ravel()
    outputs = found.fits[0].measured.outputs
    assert str(outputs[int(errors.argmax())]) in found.plot_frf().axes[0].get_title(loc="left")


def test_plots_stand_on_axes_of_ones_own(found):
    mine = Figure()
    upper, lower = mine.subplots(2)
    assert found.plot_frf(axes=[upper, lower]) is mine
    assert pieces(upper) > 0 < pieces(lower)
    alone = Figure().subplots()
    found.plot_frf(axes=alone)
    assert alone.get_yscale() == "log"
    with pytest.raises(InputError, match="`axes` must be 1, one for each panel, got 2"):
        found.plot_parameters([upper, lower])


def test_structures_and_modes_are_drawn(found, tmp_path):
    assert pieces(found.structure.plot_structure().axes[0]) > 0
    write_record(tmp_path / "tower.npz", ambient(duration=120.0))
    modes = modes_of_file(tmp_path / "tower.npz", ModesOptions("ssi_cov"))
    assert pieces(modes.plot_stabilization().axes[0]) > 0
    shapes = found.plot_modes()
    assert len(shapes.axes) == len(found.modes.frequency)
    assert "mode 1" in found.plot_modes(1).axes[0].get_title(loc="left")
    assert pieces(found.plot_frequencies().axes[0]) > 0
    with pytest.raises(InputError, match="`mode` must be between 1 and"):
        found.plot_modes(99)
    assert "mode 2" in modes.plot_modes(2).axes[0].get_title(loc="left")
    with pytest.raises(InputError, match="`mode` must be between 1 and"):
        modes.plot_modes(0)
    with pytest.raises(InputError, match="no orders"):
        modes_of_file(tmp_path / "tower.npz", ModesOptions("bayesian_fft")).plot_stabilization()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"sensor": "99X"}, "`sensor` must be one of"),
        ({"load": "99X"}, "`load` must be one of"),
        ({"record": 3}, "1 records"),
    ],
)
def test_what_is_not_there_is_named(found, given, words):
    with pytest.raises(InputError, match=words):
        found.plot_frf(**given)
