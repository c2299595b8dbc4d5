"""Units that attributes of HDF5 datasets state, and uneven clocks of loggers."""

import h5py
import numpy as np
import pytest

from structid.core.errors import InputError
from structid.records import ReadOptions, read_record

GRAVITY = 9.80665
HISTORY = np.random.default_rng(0).standard_normal((50, 2))
FRF = HISTORY[:, :1] + 1j * HISTORY[:, 1:]


def stored(path, **attributes):
    with h5py.File(path, "w") as file:
        file["test/acc"] = HISTORY
        for key, value in attributes.items():
            file["test/acc"].attrs[key] = value
    return path


@pytest.mark.parametrize(
    "attributes, factors, quantities",
    [
        ({"units": "g"}, [GRAVITY, GRAVITY], ("acceleration", "acceleration")),
        ({"Unit": np.bytes_(b"mm/s^2")}, [1e-3, 1e-3], ("acceleration", "acceleration")),
        ({"UNITS": ["g", "N"]}, [GRAVITY, 1.0], ("acceleration", "force")),
    ],
)
def test_units_of_histories_are_those_of_their_attribute(tmp_path, attributes, factors, quantities):
    path = stored(tmp_path / "a.h5", **attributes)
    record = read_record(path, ReadOptions(sampling_rate=100.0, channels="1X,2X"))
    assert record.values == pytest.approx(HISTORY * factors)
    assert record.quantities == quantities
    assert "by its attribute" in record.source


@pytest.mark.parametrize(
    "units, is_refused", [("m/s^2", True), ("g", False), ("gn,g's", False), ("g,m/s^2", True), ("mm", True)]
)
def test_units_that_contradict_the_attribute_are_refused(tmp_path, units, is_refused):
    path = stored(tmp_path / "a.h5", unit="g")
    options = ReadOptions(sampling_rate=100.0, channels="1X,2X", units=units)
    if is_refused:
        with pytest.raises(InputError, match="'test/acc' states g as its unit, but `units`"):
            read_record(path, options)
    else:
        assert read_record(path, options).values == pytest.approx(HISTORY * GRAVITY)


def test_attributes_that_are_no_units_are_refused(tmp_path):
    with pytest.raises(InputError, match="'counts'"):
        read_record(stored(tmp_path / "a.h5", units="counts"), ReadOptions(sampling_rate=100.0, channels="1X,2X"))
    path = stored(tmp_path / "b.h5", units=3.0, note="g")
    with pytest.raises(InputError, match="does not say what its channels hold"):
        read_record(path, ReadOptions(sampling_rate=100.0, channels="1X,2X"))


def test_units_of_frfs_and_frequencies_are_those_of_their_attributes(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["h"], file["f"] = FRF[:, :, None], np.arange(1.0, 51.0)
        file["h"].attrs["unit"], file["f"].attrs["units"] = "g/lbf", "rad/s"
    given = {"array": "h", "frequency_array": "f", "outputs": "1X", "inputs": "1X"}
    record = read_record(path, ReadOptions(**given))
    assert record.frequency == pytest.approx(np.arange(1, 51) / (2 * np.pi))
    assert record.values == pytest.approx(FRF[:, :, None] * GRAVITY / (0.45359237 * GRAVITY))
    with pytest.raises(InputError, match="`axis_unit`"):
        read_record(path, ReadOptions(**given, axis_unit="Hz"))
    with pytest.raises(InputError, match="`unit`"):
        read_record(path, ReadOptions(**given, unit="m/N"))


def test_uneven_times_of_loggers_are_resampled_on_request(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    path, rng = tmp_path / "a.tdms", np.random.default_rng(1)
    time = 0.5 + np.arange(400) / 200 + 2e-4 * rng.standard_normal(400)
    wave = np.sin(2 * np.pi * 7 * time)
    channels = [("Time", time, "s"), ("1X", wave, "g"), ("2X", 2 * wave, "m/s^2")]
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.ChannelObject("T", n, v, properties={"unit_string": u}) for n, v, u in channels])
    with pytest.raises(
        InputError, match="must hold even, increasing times; bring the samples to an even raster with `resample"
    ):
        read_record(path)
    record = read_record(path, ReadOptions(resample="spline"))
    even = np.linspace(time[0], time[-1], 400)
    assert (record.start, record.sampling_rate) == pytest.approx((time[0], 399 / (time[-1] - time[0])))
    assert record.values[5:-5, 0] == pytest.approx(GRAVITY * np.sin(2 * np.pi * 7 * even)[5:-5], abs=2e-4)
    assert record.values[5:-5, 1] == pytest.approx(2 * np.sin(2 * np.pi * 7 * even)[5:-5], abs=1e-4)
    assert "off an even raster; errs by up to" in record.source


def test_uneven_times_of_mdf_are_resampled_on_request(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    path, rng = tmp_path / "a.mf4", np.random.default_rng(1)
    time = np.arange(400) / 200 + 2e-4 * rng.standard_normal(400)
    file = asammdf.MDF(version="4.10")
    file.append([asammdf.Signal(np.sin(2 * np.pi * 7 * time), time, name="1X", unit="g")])
    file.save(path, overwrite=True)
    file.close()
    with pytest.raises(InputError, match="is not sampled evenly"):
        read_record(path)
    record = read_record(path, ReadOptions(resample="spline"))
    even = np.linspace(time[0], time[-1], 400)
    assert record.values[5:-5, 0] == pytest.approx(GRAVITY * np.sin(2 * np.pi * 7 * even)[5:-5], abs=2e-4)
