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


def save(path, fields):
    """Write nested `fields` to an NPZ (of the first level), MAT or HDF5 file."""
    if path.suffix == ".npz":
        np.savez(path, **fields)
    elif path.suffix == ".mat":
        from scipy.io import savemat

        savemat(path, fields)
    else:
        with h5py.File(path, "w") as file:

            def store(group, level):
                for name, value in level.items():
                    if isinstance(value, dict):
                        store(group.create_group(name), value)
                    else:
                        group[name] = value

            store(file, fields)
    return path


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
@pytest.mark.parametrize(
    "beside, words",
    [
        ({"units": "g"}, "units says 'g' beside array 'acc'"),
        ({"Unit": "mV"}, "Unit says 'mV' beside array 'acc'"),
        ({"units": "m/s^2"}, ""),
        ({"fs": 50.0}, "fs says 50 samples a second"),
        ({"SampleRate": 100.0}, ""),
        ({"dt": 0.02}, "dt says 50 samples a second"),
        ({"dt": 0.01}, ""),
        ({"t": np.arange(50) / 50}, "t says 50 samples a second"),
        ({"Time": np.arange(50)[:, None] / 100}, ""),
        ({"time": np.arange(50) * 10.0}, ""),  # ms
        ({"note": "g", "factor": 50.0}, ""),
    ],
)
def test_what_stands_beside_an_array_is_not_contradicted_in_silence(tmp_path, suffix, beside, words):
    path = save(tmp_path / f"a{suffix}", {"acc": HISTORY, **beside})
    options = {"array": "acc", "sampling_rate": 100.0, "channels": "1X,2X"}
    if words:
        with pytest.raises(InputError, match=words):
            read_record(path, ReadOptions(**options, quantities="acceleration"))
    else:
        assert read_record(path, ReadOptions(**options, quantities="acceleration")).values == pytest.approx(HISTORY)
    if "nit" in next(iter(beside)):  # a unit that is given is the user's word
        record = read_record(path, ReadOptions(**options, units="g"))
        assert record.values == pytest.approx(HISTORY * GRAVITY)
        assert record.source.endswith("though units says m/s^2") == (beside == {"units": "m/s^2"})


@pytest.mark.parametrize("suffix", [".mat", ".h5"])
def test_structs_of_test_software_are_not_contradicted_in_silence(tmp_path, suffix):
    struct = {
        "x_values": {"start_value": 0.0, "increment": 0.02},
        "y_values": {"values": HISTORY, "quantity": {"label": "g"}},
    }
    path = save(tmp_path / f"a{suffix}", {"Signal": struct, "Other": {"units": "mm", "fs": 7.0}})
    array = "Signal.y_values.values" if suffix == ".mat" else "Signal/y_values/values"
    given = {"array": array, "channels": "1X,2X"}
    with pytest.raises(InputError, match="increment says 50 samples a second"):
        read_record(path, ReadOptions(**given, sampling_rate=100.0, units="g"))
    with pytest.raises(InputError, match="label says 'g' beside array"):
        read_record(path, ReadOptions(**given, sampling_rate=50.0, quantities="acceleration"))
    assert read_record(path, ReadOptions(**given, sampling_rate=50.0, units="g")).sampling_rate == 50.0


def test_attributes_of_the_array_and_the_file_are_not_contradicted_in_silence(tmp_path):
    given = {"sampling_rate": 100.0, "channels": "1X,2X"}
    path = stored(tmp_path / "a.h5", unit="g")
    record = read_record(path, ReadOptions(**given, quantities="acceleration"))
    assert record.values == pytest.approx(HISTORY * GRAVITY)
    with pytest.raises(InputError, match="unit of acceleration, but `quantities` says velocity"):
        read_record(path, ReadOptions(**given, quantities="velocity"))
    with pytest.raises(InputError, match="wf_increment says 50 samples"):
        read_record(stored(tmp_path / "b.h5", wf_increment=0.02), ReadOptions(**given, units="g"))
    with pytest.raises(InputError, match=r"stored scaled: test/acc@scale_factor is 0.001"):
        read_record(stored(tmp_path / "c.h5", scale_factor=0.001), ReadOptions(**given, units="g"))
    for name, neutral in (("gain", 1.0), ("Calibration_Factor", 1.0), ("offset", 0.0), ("cal_factors", 1.0)):
        scaled = stored(tmp_path / "d.h5", **{name: 0.25})
        with pytest.raises(InputError, match=f'may be stored scaled: test/acc@{name} is 0.25; say .*`units = "m/s.2"`'):
            read_record(scaled, ReadOptions(**given, quantities="acceleration"))
        done = read_record(scaled, ReadOptions(**given, units="g"))
        assert done.values == pytest.approx(HISTORY * GRAVITY)
        assert f"test/acc@{name} is 0.25, which is not applied" in done.source
        neutral_file = stored(tmp_path / "d.h5", **{name: neutral})
        assert "not applied" not in read_record(neutral_file, ReadOptions(**given, quantities="acceleration")).source
    taken_out = read_record(stored(tmp_path / "f.h5", unit="m/s^2", gain=10.0, offset=0.5), ReadOptions(**given))
    assert taken_out.values == pytest.approx(HISTORY)
    assert "gain is 10, which is not applied" in taken_out.source
    assert "offset is 0.5, which is not applied" in taken_out.source
    sensed = stored(tmp_path / "e.h5", sensitivity=[0.1, 0.2])
    with pytest.raises(InputError, match=r"acc@sensitivity is 0.1, 0.2; say what its values are.*V at 100 mV/g"):
        read_record(sensed, ReadOptions(**given, quantities="acceleration"))
    assert (
        "sensitivity is 0.1, 0.2, which is not applied" in read_record(sensed, ReadOptions(**given, units="g")).source
    )
    with h5py.File(path, "a") as file:
        file.attrs["Sampling rate"] = 50.0
    with pytest.raises(InputError, match=r"@Sampling rate says 50 samples"):
        read_record(path, ReadOptions(**given))


def test_tables_and_references_called_as_scales_are_left_alone(tmp_path):
    path = stored(tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        file["bridge/calibration"] = np.zeros(3, dtype=[("sensor", "S8"), ("factor", float)])
        file["bridge/scale"] = np.array([file["test/acc"].ref], dtype=h5py.ref_dtype)
        file.create_dataset("bridge/offset", (2,), dtype=h5py.vlen_dtype(float))
        file["bridge/gain"] = 3.0 + 1j
    given = {"array": "test/acc", "sampling_rate": 100.0, "channels": "1X,2X", "quantities": "acceleration"}
    assert read_record(path, ReadOptions(**given)).values == pytest.approx(HISTORY)


def test_whole_numbers_of_a_gain_are_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["acc"] = np.arange(40, dtype=np.int16).reshape(20, 2) % 7
        file["acc"].attrs["gain"] = 0.01
    with pytest.raises(InputError, match=r"is stored scaled: acc@gain is 0\.01"):
        read_record(tmp_path / "a.h5", ReadOptions(sampling_rate=100.0, channels="1X,2X", units="g"))


def test_an_array_is_no_scale_of_itself_nor_is_another_history(tmp_path):
    """Arrays named as scales: the one that is read, one of as many values as samples, and complex ones."""
    beside = {"gain": np.linspace(1.0, 2.0, 50), "offset": np.array([1j, 2.0]), "scale": 1.5}
    path = save(tmp_path / "a.npz", {"calibration": HISTORY, **beside})
    given = {"sampling_rate": 100.0, "channels": "1X,2X", "units": "g"}
    source = read_record(path, ReadOptions(array="calibration", **given)).source
    assert source.endswith("; scale is 1.5, which is not applied")
    assert source.count("not applied") == 1


def test_frequency_responses_with_a_sensitivity_ask_for_their_own_unit(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["h"], file["f"] = FRF, np.arange(1.0, 51.0)
        file["h"].attrs["sensitivity"] = 0.1
    given = {"array": "h", "frequency_array": "f", "outputs": "1X", "inputs": "1X"}
    with pytest.raises(
        InputError,
        match=r"has a sensitivity, h@sensitivity is 0.1; .*`unit = .\(m/s\^2\)/N.`.*--unit '\(m/s\^2\)/N' on",
    ):
        read_record(tmp_path / "a.h5", ReadOptions(**given, kind="accelerance"))
    read = read_record(tmp_path / "a.h5", ReadOptions(**given, unit="(m/s^2)/N"))
    assert "sensitivity is 0.1, which is not applied" in read.source


def test_whole_numbers_and_gains_beside_an_array_are_said(tmp_path):
    path = save(tmp_path / "a.mat", {"y": np.arange(40, dtype=np.int16).reshape(20, 2) % 7, "gain": 2.0})
    source = read_record(path, ReadOptions(array="y", sampling_rate=100.0, channels="1X,2X", units="g")).source
    assert "gain is 2, which is not applied" in source
    assert "whole numbers (int16)" in source


def test_units_beside_frequency_responses_are_not_contradicted_in_silence(tmp_path):
    path = save(tmp_path / "a.mat", {"h": FRF, "f": np.arange(1.0, 51.0), "units": "g/lbf"})
    given = {"array": "h", "frequency_array": "f", "outputs": "1X", "inputs": "1X"}
    with pytest.raises(InputError, match="units says 'g/lbf' beside array 'h', and `kind` alone"):
        read_record(path, ReadOptions(**given, kind="accelerance"))
    assert read_record(path, ReadOptions(**given, unit="g/N")).values[:, 0, 0] == pytest.approx(FRF[:, 0] * GRAVITY)


@pytest.mark.parametrize("beside, options, words", [
    ({"fs_khz": 0.1}, {"units": "g"}, "fs_khz says 100 samples a second"),
    ({"dt_ms": 10.0}, {"units": "g"}, "dt_ms says 100 samples a second"),
    ({"time_us": np.arange(50.0) * 1e4}, {"units": "g"}, "time_us says 100 samples a second"),
    ({"channels": np.array(["1X", "2Y"])}, {"units": "g"}, r"says channels 1X\+, 2Y\+, but `channels` 1X\+, 2X\+ was given"),
])  # fmt: skip
def test_units_rates_and_channels_beside_arrays_are_not_contradicted(tmp_path, beside, options, words):
    np.savez(tmp_path / "a.npz", acc=HISTORY, **beside)
    options = ReadOptions(sampling_rate=200.0, channels="1X,2X", array="acc", **options)
    with pytest.raises(InputError, match=words):
        read_record(tmp_path / "a.npz", options)


@pytest.mark.parametrize("beside, units, words", [
    ({"units": np.array(["g", "mm/s"])}, "g,m/s", "though units says mm/s"), ({"acc_unit": "mm"}, "m", "though acc_unit says mm"),
    ({"acc_unit": "mm"}, "mm", ""), ({"units": "m"}, "g", ""),
])  # fmt: skip
def test_a_unit_beside_an_array_that_is_overruled_is_said(tmp_path, beside, units, words):
    np.savez(tmp_path / "a.npz", acc=HISTORY, **beside)
    record = read_record(
        tmp_path / "a.npz", ReadOptions(sampling_rate=200.0, channels="1X,2X", array="acc", units=units)
    )
    assert record.source.endswith(words or "a.npz")


def test_an_array_that_says_its_unit_by_its_name_is_not_contradicted(tmp_path):
    np.savez(tmp_path / "a.npz", acc_g=HISTORY)
    with pytest.raises(InputError, match="'acc_g' says another unit by its name"):
        read_record(tmp_path / "a.npz", ReadOptions(sampling_rate=200.0, channels="1X,2X", units="m/s^2"))
    record = read_record(tmp_path / "a.npz", ReadOptions(sampling_rate=200.0, channels="1X,2X", units="g"))
    np.testing.assert_allclose(record.values, HISTORY * GRAVITY)


@pytest.mark.parametrize(
    ("times", "kind"),
    [
        (0.005 * np.arange(50), "f8"),
        (0.005 * np.arange(50), "f4"),
        (np.round(np.arange(50) / 201, 4), "f8"),
        (1.7e9 + 0.005 * np.arange(50), "f8"),
    ],
    ids=["exact", "single precision", "rounded", "since 1970"],
)
def test_times_among_the_channels_of_an_array_are_refused(tmp_path, times, kind):
    np.save(tmp_path / "a.npy", np.column_stack([times, HISTORY]).astype(kind))
    with pytest.raises(InputError, match=r"column 1 of the array rises in even steps of 0.005, as times and counts do"):
        read_record(tmp_path / "a.npy", ReadOptions(sampling_rate=200.0, channels="1X,2X,3X", units="g"))


@pytest.mark.parametrize("name, given, factor", [
    ("omega", "rad/s", 1 / (2 * np.pi)), ("omega", "", None), ("w_rad", "", None), ("rpm", "", 1 / 60), ("freq_khz", "", 1e3),
    ("freq_khz", "Hz", None), ("freq_hz", "", 1.0), ("frequency", "kHz", 1e3), ("frequency", "", 1.0),
])  # fmt: skip
def test_frequencies_are_in_the_unit_that_their_name_says(tmp_path, name, given, factor):
    lines = np.arange(1.0, 51.0)
    np.savez(tmp_path / "a.npz", H=FRF, **{name: lines})
    options = ReadOptions(array="H", frequency_array=name, outputs="1Z", inputs="3Z", kind="mobility", axis_unit=given)
    if factor is None:
        with pytest.raises(InputError, match=f"array '{name}' (says by its name|does not say the unit)"):
            read_record(tmp_path / "a.npz", options)
    else:
        np.testing.assert_allclose(read_record(tmp_path / "a.npz", options).frequency, lines * factor)


@pytest.mark.parametrize(
    ("text", "is_refused"), [("200 Hz", True), ("0.2 kHz", True), ("100", False), ("100 S/s", False)]
)
def test_a_rate_in_words_must_agree(tmp_path, text, is_refused):
    path = stored(tmp_path / "a.h5", sampling_frequency=text)
    options = ReadOptions(sampling_rate=100.0, channels="1X,2X", units="g")
    if is_refused:
        with pytest.raises(InputError, match=r"sampling_frequency says 200 samples a second, but `sampling_rate` 100"):
            read_record(path, options)
    else:
        assert read_record(path, options).sampling_rate == 100.0


@pytest.mark.parametrize(
    ("key", "value", "stated"),
    [
        ("SampleRate", 200.0, 200),
        ("SampleFrequency", "50", 50),
        ("dt", 0.01, 0),
        ("fs_khz", 0.05, 50),
        ("dt_ms", 10.0, 0),
        ("fs", np.inf, 0),
    ],
)
def test_a_rate_that_stands_elsewhere_is_said(tmp_path, key, value, stated):
    path = stored(tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        file.create_group("header").attrs[key] = value
    source = read_record(path, ReadOptions(sampling_rate=100.0, channels="1X,2X", units="g")).source
    assert ("sampled at 100 Hz as given, though header" in source) == bool(stated)
    assert source.endswith(f"{key} says {stated}") == bool(stated)


def test_a_rate_of_another_array_is_not_said_where_the_own_one_agrees(tmp_path):
    path = save(tmp_path / "a.h5", {"acc": {"data": HISTORY, "fs": 100.0}, "strain": {"fs": 50.0}})
    options = ReadOptions(array="acc/data", sampling_rate=100.0, channels="1X,2X", units="g")
    assert "strain" not in read_record(path, options).source
