"""Arrays that do not describe themselves: read as told, and nothing guessed."""

import h5py
import numpy as np
import pytest
import scipy.io

from structid.core.errors import FileError, InputError
from structid.records import ReadOptions, read_record

FRF = ReadOptions(
    array="h", frequency_array="f", outputs=("1X-", "2X", "3X"), inputs=("9Z+", "8Z-"), kind="accelerance"
)


def save(path, **arrays):
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, arrays)
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array
    else:
        np.save(path, arrays["h"])
    return path


@pytest.fixture
def arrays(rng):
    return {
        "h": rng.normal(size=(5, 3, 2)) + 1j * rng.normal(size=(5, 3, 2)),
        "f": np.arange(5.0),
        "g": np.ones((5, 3, 2)),
    }


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".mat"])
def test_bare_frf(tmp_path, suffix, arrays):
    record = read_record(save(tmp_path / f"a{suffix}", **arrays), FRF)
    np.testing.assert_array_equal(record.values, arrays["h"])
    np.testing.assert_array_equal(record.frequency, arrays["f"])
    assert [str(d) for d in (*record.outputs, *record.inputs)] == ["1X-", "2X+", "3X+", "9Z+", "8Z-"]
    assert record.kind == "accelerance"
    assert record.coherence is None
    assert record.averages is None


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".mat"])
def test_bare_frf_with_unit_coherence_and_one_input(tmp_path, suffix, arrays):
    path = save(tmp_path / f"a{suffix}", h=arrays["h"][:, :, 0], f=arrays["f"], g=0.5 * arrays["g"][:, :, 0])
    options = ReadOptions(
        array="h", frequency_array="f", outputs="1X,2X,3X", inputs="9Z", unit="mm/kN", coherence_array="g", averages=7
    )
    record = read_record(path, options)
    assert record.values.shape == (5, 3, 1)
    np.testing.assert_allclose(record.values[:, :, 0], arrays["h"][:, :, 0] * 1e-6, rtol=1e-15)
    assert (record.kind, record.averages) == ("receptance", 7)
    assert (record.coherence == 0.5).all()


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".mat", ".npy"])
def test_bare_time(tmp_path, suffix, rng):
    values = rng.normal(size=(20, 2))
    path = save(tmp_path / f"a{suffix}", h=values)
    record = read_record(path, ReadOptions(sampling_rate=50, channels="1Z+,2Z-", units=("g", "kN")))
    np.testing.assert_allclose(record.values, values * [9.80665, 1000], rtol=1e-15)
    assert record.quantities == ("acceleration", "force")
    assert record.sampling_rate == 50
    record = read_record(path, ReadOptions(sampling_rate=50, channels="1Z+,2Z-", quantities="velocity"))
    np.testing.assert_array_equal(record.values, values)
    assert record.quantities == ("velocity", "velocity")


@pytest.mark.parametrize(
    "given, word",
    [
        ({"channels": "1Z,2Z", "units": "g"}, "`sampling_rate` in.*--sampling-rate"),
        ({"sampling_rate": 50, "units": "g"}, "`channels` in.*--channels"),
        ({"sampling_rate": 50, "channels": "1Z,2Z"}, "`units` in"),
        ({}, "`sampling_rate` in"),
        ({"sampling_rate": 50, "channels": "1Z", "units": "g"}, "1 channels .* shape \\(20, 2\\)"),
        ({"sampling_rate": 50, "channels": "1Z,2Z", "units": "furlong"}, "'furlong'"),
        ({"sampling_rate": 50, "channels": "1Z,2Z", "units": ("g", "g", "g")}, "1 or 2 entries"),
        ({"sampling_rate": 50, "channels": "1Z,2RZ", "units": "g"}, "rotation"),
        ({"sampling_rate": 50, "channels": "1Z,2Z", "quantities": "speed"}, "displacement, velocity"),
        ({"sampling_rate": 50, "channels": "1Z,2Z", "units": "g", "quantities": "force"}, "unit of acceleration"),
        ({"sampling_rate": 50, "channels": "1Z,1Z", "units": "g"}, "twice"),
        ({"sampling_rate": 50, "channels": "1Z,2Z", "units": "g", "kind": "receptance"}, "frequency_array"),
    ],
)
def test_bare_time_refuses(tmp_path, rng, given, word):
    path = save(tmp_path / "a.npy", h=rng.normal(size=(20, 2)))
    with pytest.raises(InputError, match=word) as caught:
        read_record(path, ReadOptions(**given))
    assert str(caught.value).startswith(f"{path}:")


def test_bare_time_turned(tmp_path, rng):
    path = save(tmp_path / "a.npy", h=rng.normal(size=(2, 20)))
    with pytest.raises(InputError, match="turned"):
        read_record(path, ReadOptions(sampling_rate=50, channels="1Z,2Z", units="g"))


@pytest.mark.parametrize(
    "changes, word",
    [
        ({"kind": ""}, "`kind` in"), ({"outputs": ()}, "`outputs` in"), ({"inputs": ()}, "`inputs` in"),
        ({"array": "x"}, r"no array 'x'; its arrays are f \(5,\)"), ({"array": ""}, "`array` in"),
        ({"frequency_array": ""}, "`frequency_array` in"), ({"frequency_array": "q"}, "no array 'q'"),
        ({"outputs": ("1X", "2X")}, r"shape \(5, 3, 2\).*\(5, 2, 2\)"), ({"kind": "inertance"}, "receptance"),
        ({"unit": "m/N"}, "receptance, but `kind` says accelerance"), ({"unit": "rad/N", "kind": ""}, "rotation"),
        ({"sampling_rate": 3.0}, "`sampling_rate` belongs"), ({"outputs": ("1X", "1X", "3X")}, "twice"),
        ({"array": "g"}, "real"), ({"coherence_array": "z"}, "no array 'z'"),
    ],
)  # fmt: skip
def test_bare_frf_refuses(tmp_path, arrays, changes, word):
    import dataclasses

    path = save(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match=word) as caught:
        read_record(path, dataclasses.replace(FRF, **changes))
    assert str(caught.value).startswith(f"{path}:")


def test_struct_fields_and_deep_datasets(tmp_path, arrays):
    import dataclasses

    scipy.io.savemat(tmp_path / "a.mat", {"test": {"h": arrays["h"], "f": arrays["f"], "note": "x"}})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["test/h"], file["test/f"], file["test/huge"] = arrays["h"], arrays["f"], np.ones(9)
    for name, dot in (("a.mat", "."), ("a.h5", "/")):
        options = dataclasses.replace(FRF, array=f"test{dot}h", frequency_array=f"test{dot}f")
        np.testing.assert_array_equal(read_record(tmp_path / name, options).values, arrays["h"])


def test_mat_73_conventions(tmp_path, arrays):
    """Axes reversed, complex as a compound of real and imag, characters as codes, as MATLAB writes them."""
    path = tmp_path / "a.mat"
    turned = arrays["h"].T
    compound = np.empty(turned.shape, dtype=[("real", "<f8"), ("imag", "<f8")])
    compound["real"], compound["imag"] = turned.real, turned.imag
    with h5py.File(path, "w", userblock_size=512) as file:
        file["h"], file["f"] = compound, arrays["f"][:, None]
        file["note"] = np.array([[ord(c)] for c in "text"], dtype="u2")
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    np.testing.assert_array_equal(read_record(path, FRF).values, arrays["h"])


def test_objects_are_never_unpickled(tmp_path):
    np.savez(tmp_path / "a.npz", h=np.array([{"a": 1}], dtype=object))
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], dtype=object))
    for name in ("a.npz", "a.npy"):
        with pytest.raises(FileError, match="can run code"):
            read_record(tmp_path / name, ReadOptions(sampling_rate=1, channels="1X", units="g"))


@pytest.mark.parametrize(
    "bad",
    [
        {"sampling_rate": 0},
        {"sampling_rate": "fast"},
        {"averages": 0},
        {"averages": 1.5},
        {"channels": 3},
        {"array": 3},
    ],
)
def test_options_refuse(bad):
    with pytest.raises(InputError, match=f"`{next(iter(bad))}` must be"):
        ReadOptions(**bad)


def test_structid_layout_saved_again_as_73(tmp_path, frf):
    """structid's fields as MATLAB's `save -v7.3` stores them: texts as codes, lists of texts as references."""
    from structid.records.formats.layout import fields_of

    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:

        def characters(name, text):
            file[name] = np.frombuffer(text.encode("utf-16-le"), dtype="u2")[:, None]
            file[name].attrs["MATLAB_class"] = np.bytes_("char")
            return file[name].ref

        for name, field in fields_of(frf).items():
            if isinstance(field, str):
                characters(name, field)
            elif isinstance(field, tuple):
                cells = [characters(f"#refs#/{name}{i}", text) for i, text in enumerate(field)]
                file.create_dataset(name, data=np.array([cells], dtype=object), dtype=h5py.ref_dtype)
                file[name].attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                file[name] = field.T
    record = read_record(path)
    np.testing.assert_array_equal(record.values, frf.values)
    np.testing.assert_array_equal(record.variance, frf.variance)
    assert (record.outputs, record.inputs, record.source) == (frf.outputs, frf.inputs, frf.source)
