"""Stored spectra of files, written here byte by byte from a system of masses and springs, and the modes in them."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from structid.cli.app import app
from structid.core.errors import InputError, StoredSpectraError
from structid.modal import HardCriteria, identify_modes
from structid.modal.survey.options import ModesOptions
from structid.modal.survey.survey import modes_of_file
from structid.records import ReadOptions, SpectrumRecord, read_record, read_spectrum

GRAVITY = 9.80665
MASS = np.diag([2.0, 1.0, 1.5])
STIFFNESS = np.array([[5e4, -2e4, 0], [-2e4, 4e4, -1.5e4], [0, -1.5e4, 3e4]])
LINES = 5.0 + 0.05 * np.arange(900)


def system():
    """Natural frequencies (Hz) and shapes, and acceleration spectra (n_lines, 3, 3) under white forces."""
    values, shapes = np.linalg.eig(np.linalg.solve(MASS, STIFFNESS))
    order = np.argsort(values)
    omega = 2 * np.pi * LINES
    damping = 2e-4 * STIFFNESS
    dynamic = STIFFNESS - omega[:, None, None] ** 2 * MASS + 1j * omega[:, None, None] * damping
    response = -(omega[:, None, None] ** 2) * np.linalg.inv(dynamic)
    return np.sqrt(values[order]) / (2 * np.pi), shapes[:, order], response @ response.conj().transpose(0, 2, 1)


FREQUENCY, SHAPES, SPECTRA = system()


def function(i, j, values, kind, label="(m/s^2)^2/Hz", number=12, title="averages: 60", below=(0, ""), is_complex=True):
    """A dataset 58 of a response and a reference at nodes i + 1 and j + 1 along X."""
    lines = ["    -1", "    58", title, "NONE", "NONE", "NONE", "NONE"]
    lines += [f"{kind:5d}{0:10d}{1:5d}{0:10d} {'NONE':>10s}{i + 1:10d}{1:4d} {'NONE':>10s}{j + 1:10d}{1:4d}"]
    lines += [f"{6 if is_complex else 4:10d}{len(values):10d}{1:10d}{LINES[0]:13.5E}{0.05:13.5E}{0.0:13.5E}"]
    heads = [(18, "Hz"), (number, label), (below[0], below[1]), (0, "")]
    lines += [f"{number:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {label or 'NONE':<20s}" for number, label in heads]
    parts = np.stack([values.real, values.imag], axis=1).ravel() if is_complex else values.real
    width = 2 if is_complex else 4
    lines += ["".join(f"{x:20.12E}" for x in parts[k : k + width]) for k in range(0, len(parts), width)]
    return "\n".join([*lines, "    -1", ""])


def universal(path, pairs, factor=1.0, **options):
    text = ""
    for i, j in pairs:
        text += function(i, j, SPECTRA[:, i, j] / factor, options.pop("kind", 0) or (2 if i == j else 3), **options)
    path.write_text(text)
    return path


ALL = [(i, j) for i in range(3) for j in range(3)]
LOWER = [(i, j) for i, j in ALL if i >= j]
TO_SECOND = [(0, 1), (1, 1), (2, 1)]


def resembles(modes):
    assert modes.frequency == pytest.approx(FREQUENCY, abs=0.05)
    for found, true in zip(modes.mode_shapes.T, SHAPES.T, strict=True):
        assert abs(found.conj() @ true) ** 2 / (found.conj() @ found).real / (true @ true) > 0.99
    # viscous damping of 2e-4 K: ratios of omega 1e-4; the difference that an unknown window makes is in the deviations
    true = 2 * np.pi * FREQUENCY * 1e-4
    assert modes.damping_ratio == pytest.approx(true, rel=0.05)  # the tails of other modes lean on the bell
    assert (np.abs(modes.damping_ratio - true) < modes.std[3:]).all()
    assert (modes.std[3:] < 0.15 * true).all()


@pytest.mark.parametrize("pairs", [ALL, LOWER, TO_SECOND], ids=["all", "lower", "one reference"])
@pytest.mark.parametrize(
    "label, factor",
    [
        ("(m/s^2)^2/Hz", 1.0),
        ("g^2/Hz", GRAVITY**2),
        ("g\u00b2/Hz", GRAVITY**2),
        ("m^2/s^4", 1.0),
        ("g2/Hz", GRAVITY**2),
        ("(mm/s2)2/Hz", 1e-6),
        ("(mm/s^2)**2/Hz", 1e-6),
        ("g*m/s^2", GRAVITY),
    ],
)
def test_spectra_of_universal_files_come_in_si(tmp_path, pairs, label, factor):
    path = universal(tmp_path / "a.unv", pairs, factor, label=label)
    path.write_bytes(path.read_text().encode("latin-1"))
    record = read_spectrum(path)
    columns = [record.channels.index(dof) for dof in record.references]
    assert len(record.references) == (1 if pairs == TO_SECOND else 3)
    order = [dof.node - 1 for dof in record.channels]
    expected = SPECTRA[:, order][:, :, [order[c] for c in columns]]
    assert record.values == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
    assert (record.averages, set(record.quantities)) == (60, {"acceleration"})
    resembles(identify_modes(record.__class__(
        record.frequency, record.values[:, np.argsort(order)], [record.channels[k] for k in np.argsort(order)],
        record.references, record.quantities, 60,
    )))  # fmt: skip


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"label": "g"}, "no square or product of motions"),
        ({"label": "g rms/Hz"}, "no square or product of motions"),
        ({"label": "m/s^2"}, "no square or product of motions"),
        ({"label": "g/\u221aHz"}, "no square or product of motions"),
        ({"label": "", "number": 12}, "nothing says the unit of the acceleration"),
        ({"label": "N^2/Hz", "number": 13}, "are of force, not of motion"),
        ({"label": "g^2/Hz", "number": 8}, "displacement by their type but acceleration by their unit"),
        ({"label": "g^2", "below": (12, "g")}, "with a motion or force below it"),
        ({"is_complex": False}, "holds real numbers only"),
    ],
)
def test_spectra_that_say_too_little_are_refused(tmp_path, changes, words):
    with pytest.raises(InputError, match=words.replace("^", r"\^")):
        read_spectrum(universal(tmp_path / "a.unv", LOWER, **changes))


def test_options_may_be_arrays(tmp_path):
    path, given = tmp_path / "a.npy", {"frequencies": (12.0, 31.0), "band": (1.0, 60.0)}
    time, rng = np.arange(2000) / 200, np.random.default_rng(0)
    tones = np.stack([np.sin(2 * np.pi * f * time) for f in given["frequencies"]], axis=1)
    np.save(path, tones @ [[1.0, 0.6], [0.8, -1.0]] + 0.1 * rng.standard_normal((2000, 2)))
    read = ReadOptions(sampling_rate=200.0, units="m/s^2")
    listed, arrays = (
        modes_of_file(path, ModesOptions(method="fdd", **options), read).modes.frequency.tolist()
        for options in (given, {name: np.array(value) for name, value in given.items()})
    )
    assert arrays == listed
    record = read_record(path, replace(read, channels=("1X", "2X")))
    bands = [(5.0, 20.0), (25.0, 60.0)]
    listed, arrays = (
        identify_modes(record, "bayesian_fft", bands=value).frequency.tolist() for value in (bands, np.array(bands))
    )
    assert arrays == listed


def test_limits_of_frequencies_and_their_deviations_hold_for_spectra_too(tmp_path):
    record = read_spectrum(universal(tmp_path / "a.uff", ALL))
    for beyond in (50.1, 60.0):
        with pytest.raises(
            InputError, match=rf"at most 50 Hz, one line after the last of the spectra, got {beyond:g} Hz"
        ):
            identify_modes(record, frequencies=[10.0, beyond])
    whole = identify_modes(record, criteria=HardCriteria((0.0, 50.0)))  # half the rate: LINES end at 49.95 Hz
    assert whole.frequency.tolist() == identify_modes(record).frequency.tolist()
    modes = identify_modes(record)
    order = np.argsort(modes.frequency_std / modes.frequency)
    relative = (modes.frequency_std / modes.frequency)[order]
    assert relative[0] < relative[-1]
    kept = identify_modes(record, deviation=float(relative[:2].mean()))
    assert kept.frequency.tolist() == modes.frequency[order[:1]].tolist()


def test_peaks_alone_have_no_damping(tmp_path):
    modes = modes_of_file(universal(tmp_path / "a.unv", ALL), ModesOptions(method="fdd")).modes
    assert modes.frequency == pytest.approx(FREQUENCY, abs=0.05)
    assert np.isnan(modes.damping_ratio).all()


def test_what_is_missing_or_mixed_is_refused(tmp_path):
    path = tmp_path / "a.unv"
    universal(path, [(0, 0), (1, 1), (2, 2)])
    with pytest.raises(InputError, match="autospectra alone tell no mode shape"):
        read_spectrum(path)
    universal(path, [*LOWER, (2, 1)])
    with pytest.raises(InputError, match=r"the spectrum of 3X\+ and 2X\+ twice"):
        read_spectrum(path)
    path.write_text(function(0, 0, SPECTRA[:, 0, 0], 2) + function(1, 0, SPECTRA[:, 1, 0], 3, "(m/s^2)^2"))
    with pytest.raises(InputError, match="some spectra are densities and some are not"):
        read_spectrum(path)
    path.write_text(function(0, 0, -SPECTRA[:, 0, 0], 2) + function(1, 0, SPECTRA[:, 1, 0], 3))
    with pytest.raises(InputError, match="not positive throughout"):
        read_spectrum(path)
    with pytest.raises(StoredSpectraError, match="`structid modes`"):
        read_record(universal(path, LOWER))


def test_channels_and_functions_are_chosen(tmp_path):
    path = universal(tmp_path / "a.unv", LOWER)
    record = read_spectrum(path, ReadOptions(channels="1X,3X"))
    assert [str(dof) for dof in record.channels] == ["1X+", "3X+"]
    assert record.values[:, 1, 0] == pytest.approx(SPECTRA[:, 2, 0])
    assert len(read_spectrum(path, ReadOptions(columns="1,2,3")).channels) == 2
    for options, words in (
        ({"channels": "1X,9X"}, r"no spectrum of 9X\+"),
        ({"columns": "1,99"}, "99"),
        ({"channels": "2X", "columns": "1,2"}, r"no spectrum between 2X\+ alone; .* functions: 1X\+/1X\+, 2X\+/1X\+$"),
        ({"quantities": "velocity"}, "quantities"),
    ):
        with pytest.raises(InputError, match=words):
            read_spectrum(path, ReadOptions(**options))


def test_units_and_averages_that_a_file_lacks_are_given_once(tmp_path):
    path = universal(tmp_path / "a.unv", LOWER, label="", title="NONE")
    record = read_spectrum(path, ReadOptions(units="g"))
    assert np.abs(record.values[:, 0, 0]) == pytest.approx(GRAVITY**2 * SPECTRA[:, 0, 0].real)
    with pytest.raises(InputError, match="`averages` must say how many averages"):
        modes_of_file(path, read=ReadOptions(units="g"))
    resembles(modes_of_file(path, read=ReadOptions(units="g", averages=60)).modes)


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
def test_arrays_are_spectra_by_their_kind(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    arrays = {"s": SPECTRA[:, :, :2] / 1e-6, "f": LINES}
    if suffix == ".npz":
        np.savez(path, **arrays)
    elif suffix == ".mat":
        from scipy.io import savemat

        savemat(path, arrays)
    else:
        import h5py

        with h5py.File(path, "w") as file:
            for name, values in arrays.items():
                file[name] = values
    options = ReadOptions(
        kind="spectrum",
        array="s",
        frequency_array="f",
        channels="1X,2X,3X",
        inputs="1X,2X",
        units="mm/s^2",
        averages=60,
    )
    record = read_spectrum(path, options)
    assert record.values == pytest.approx(SPECTRA[:, :, :2])
    resembles(modes_of_file(path, read=options).modes)
    for missing in ("frequency_array", "channels", "units"):
        given = {name: getattr(options, name) for name in options.given() if name != missing}
        with pytest.raises(InputError, match=missing):
            read_spectrum(path, ReadOptions(**given))


def test_the_command_finds_modes_in_stored_spectra(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    universal(tmp_path / "a.unv", LOWER, GRAVITY**2, label="g^2/Hz")
    result = CliRunner().invoke(app, ["modes", "a.unv", "--out", "out", "--no-report"])
    assert result.exit_code == 0, result.output
    assert "stored spectra of 3 channels of acceleration and 3 references" in " ".join(result.output.split())
    assert "which changes no mode" in " ".join(result.output.split())
    assert (tmp_path / "out" / "modes.json").is_file()
    result = CliRunner().invoke(app, ["modes", "a.unv", "--method", "pencil", "--out", "out2"])
    assert result.exit_code == 2


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"references": ["4X"]}, "`references` must be among the channels"),
        ({"channels": ["1X", "1X", "3X"]}, "`channels` must name each place and direction once"),
        ({"quantities": ["force"] * 3}, "`quantities` must say"),
        ({"frequency": LINES**1.01}, "`frequency` must be at least three evenly spaced"),
        ({"averages": 0}, "`averages` must be at least 1"),
        ({"values": SPECTRA[:, :2, :1]}, "`values` must have shape"),
    ],
)
def test_records_of_spectra_are_checked(changes, words):
    given = {
        "frequency": LINES,
        "values": SPECTRA[:, :, :1],
        "channels": ["1X", "2X", "3X"],
        "references": ["1X"],
        "quantities": ["acceleration"] * 3,
    }
    with pytest.raises(InputError, match=words):
        SpectrumRecord(**given | changes)
