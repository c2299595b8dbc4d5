"""Correlation functions of files, exact ones of a system of masses and springs under white forces, and the modes in them."""

import numpy as np
import pytest
from scipy import linalg
from typer.testing import CliRunner

from structid.cli.app import app
from structid.core.errors import InputError, StoredSpectraError
from structid.modal import identify_modes
from structid.modal.subspace.stored_correlations import drawn_errors
from structid.modal.survey.options import ModesOptions
from structid.modal.survey.survey import modes_of_file
from structid.records import CorrelationRecord, ReadOptions, SpectrumRecord, read_correlation, read_record

GRAVITY = 9.80665
RATE, N_LAGS = 250.0, 320
MASS = np.diag([2.0, 1.0, 1.5])
STIFFNESS = np.array([[5e4, -2e4, 0], [-2e4, 4e4, -1.5e4], [0, -1.5e4, 3e4]])
DAMPING = 2e-4 * STIFFNESS + 0.8 * MASS


def system(n_lags):
    """Natural frequencies (Hz), damping ratios, shapes, and displacement correlations (n_lags, 3, 3) of uneven white forces."""
    inverse = np.linalg.inv(MASS)
    state = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ STIFFNESS, -inverse @ DAMPING]])
    force = np.vstack([np.zeros((3, 3)), inverse]) @ np.diag([3.0, 1.0, 2.0])
    covariance = linalg.solve_continuous_lyapunov(state, -force @ force.T)
    step = linalg.expm(state / RATE)
    lags, power = [], np.eye(6)
    for _ in range(n_lags):
        lags.append((power @ covariance)[:3, :3])
        power = step @ power
    values, shapes = np.linalg.eig(state)
    up = np.flatnonzero(values.imag > 0)
    up = up[np.argsort(np.abs(values[up]))]
    s = values[up]
    return np.abs(s) / (2 * np.pi), -s.real / np.abs(s), shapes[:3, up], np.array(lags)


FREQUENCY, RATIO, SHAPES, LAGS = system(N_LAGS)
ALL = [(i, j) for i in range(3) for j in range(3)]
LOWER = [(i, j) for i, j in ALL if i >= j]
TO_SECOND = [(0, 1), (1, 1), (2, 1)]
ONE_SIDED, TWO_SIDED, WRAPPED = "one-sided", "two-sided", "wrapped"


def of_pair(i, j, sides):
    """Start of the lags in s, and values of the correlation of channels i and j."""
    forward, back = LAGS[:, i, j], LAGS[:, j, i]
    if sides == TWO_SIDED:
        return -(N_LAGS - 1) / RATE, np.concatenate([back[:0:-1], forward])
    return 0.0, np.concatenate([forward, back[:0:-1]]) if sides == WRAPPED else forward


def function(i, j, start, values, kind, label="m^2", step=1 / RATE, time=(17, "s"), number=8):
    """A dataset 58 with even lags of a response and a reference at nodes i + 1 and j + 1 along X."""
    lines = ["    -1", "    58", "averages: 90", "NONE", "NONE", "NONE", "NONE"]
    lines += [f"{kind:5d}{0:10d}{1:5d}{0:10d} {'NONE':>10s}{i + 1:10d}{1:4d} {'NONE':>10s}{j + 1:10d}{1:4d}"]
    lines += [f"{4:10d}{len(values):10d}{1:10d}{start:13.5E}{step:13.5E}{0.0:13.5E}"]
    heads = [time, (number, label), (0, ""), (0, "")]
    lines += [f"{number:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {label or 'NONE':<20s}" for number, label in heads]
    lines += ["".join(f"{x:20.12E}" for x in values[k : k + 4]) for k in range(0, len(values), 4)]
    return "\n".join([*lines, "    -1", ""])


def universal(path, pairs, sides=ONE_SIDED, factor=1.0, **options):
    text = ""
    for i, j in pairs:
        start, values = of_pair(i, j, sides)
        text += function(i, j, start, values / factor, 7 if i == j else 8, **options)
    path.write_text(text)
    return path


def resembles(modes, rel=1e-6):
    assert modes.frequency == pytest.approx(FREQUENCY, rel=rel)
    assert modes.damping_ratio == pytest.approx(RATIO, rel=100 * rel)
    for k in range(3):
        by_channel = [modes.mode_shapes[[dof.node for dof in modes.channels].index(node), k] for node in (1, 2, 3)]
        true = SHAPES[:, k]
        likeness = abs(np.vdot(by_channel, true)) ** 2 / np.vdot(by_channel, by_channel).real / np.vdot(true, true).real
        assert likeness == pytest.approx(1, abs=100 * rel)


@pytest.mark.parametrize(
    "pairs, sides",
    [
        (ALL, ONE_SIDED), (TO_SECOND, ONE_SIDED), (ALL, TWO_SIDED), (LOWER, TWO_SIDED), (LOWER, WRAPPED), (TO_SECOND, WRAPPED),
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    "label, factor", [("m^2", 1.0), ("(mm)^2", 1e-6), ("mm\u00b2", 1e-6), ("mm*m", 1e-3), ("in^2", 0.0254**2)]
)
def test_functions_of_universal_files_come_in_si(tmp_path, pairs, sides, label, factor):
    path = universal(tmp_path / "a.unv", pairs, sides, factor, label=label)
    path.write_bytes(path.read_text().encode("latin-1"))
    record = read_correlation(path)
    nodes = [[dof.node - 1 for dof in dofs] for dofs in (record.channels, record.references)]
    assert len(nodes[1]) == (1 if pairs == TO_SECOND else 3)
    assert record.values == pytest.approx(LAGS[:, nodes[0]][:, :, nodes[1]], rel=1e-9, abs=1e-12 * np.abs(LAGS).max())
    assert (record.sampling_rate, record.averages) == (pytest.approx(RATE), 90)
    assert set(record.quantities) == {"displacement"}
    if factor == 1.0:
        resembles(identify_modes(record))


@pytest.mark.parametrize("step, unit", [(1e3 / RATE, "ms"), (1 / RATE / 60, "min")])
def test_lags_in_other_units_are_converted(tmp_path, step, unit):
    path = tmp_path / "a.unv"
    parts = [function(i, j, 0.0, LAGS[:, i, j], 7 if i == j else 8, step=step, time=(17, unit)) for i, j in TO_SECOND]
    path.write_text("".join(parts))
    assert read_correlation(path).sampling_rate == pytest.approx(RATE, rel=1e-5)


def text_of(*functions):
    return "".join(function(i, j, *of_pair(i, j, sides), 7 if i == j else 8, **more) for i, j, sides, more in functions)


@pytest.mark.parametrize(
    "text, words",
    [
        (text_of(*((i, j, ONE_SIDED, {}) for i, j in LOWER)), None),
        (text_of(*((i, i, ONE_SIDED, {}) for i in range(3))), "autocorrelations alone tell no mode shape"),
        (text_of(*((i, 1, ONE_SIDED, {"label": ""}) for i in range(3))), "nothing says the unit"),
        (text_of(*((i, 1, ONE_SIDED, {"label": "m"}) for i in range(3))), "no square or product"),
        (text_of(*((i, 1, ONE_SIDED, {"label": "m^2/Hz"}) for i in range(3))), "is per Hz by its label"),
        (text_of(*((i, 1, ONE_SIDED, {"time": (18, "Hz")}) for i in range(3))), "abscissa of frequency"),
        (text_of(*((i, 1, ONE_SIDED, {"time": (17, "furlong")}) for i in range(3))), "unit label cannot be used"),
        (text_of((0, 1, ONE_SIDED, {}), (1, 1, TWO_SIDED, {}), (2, 1, ONE_SIDED, {})), "other lags than the first"),
        (text_of((0, 1, ONE_SIDED, {}), (1, 1, ONE_SIDED, {"step": 0.005}), (2, 1, ONE_SIDED, {})), "other lags"),
        ("".join(function(i, 1, 0.004, LAGS[1:, i, 1], 8) for i in range(3)), "without 0 s"),
        ("".join(function(i, 1, -0.1, LAGS[:, i, 1], 8) for i in range(3)), "not symmetric about lag 0"),
        ("".join(function(i, 1, 0.0, LAGS[::-1, i, 1], 8) for i in range(3)), "must be largest at lag 0"),
        (
            "".join(function(i, 1, 0.0, LAGS[:, i, 1] / LAGS[0, 1, 1], 8) for i in range(3)),
            "coefficients of correlation",
        ),
    ],
)
def test_functions_that_say_too_little_are_refused(tmp_path, text, words):
    path = tmp_path / "a.unv"
    path.write_text(text)
    if words is None:  # every function from lag 0 on is there for the first channel as reference only
        assert [str(dof) for dof in read_correlation(path).references] == ["1X+"]
        with pytest.raises(StoredSpectraError, match="`structid modes`"):
            read_record(path)
        return
    with pytest.raises(InputError, match=words):
        read_correlation(path)


@pytest.mark.parametrize(
    "pairs, options, words",
    [
        ([*TO_SECOND, (0, 1)], {}, r"has the correlation function of 1X\+ and 2X\+ twice"),
        (TO_SECOND, {"channels": "9X"}, r"has no correlation function of 9X\+; it has"),
        (
            TO_SECOND,
            {"channels": "1X,3X"},
            r"has no correlation function between 1X\+ and 3X\+ alone; .* 1X\+/2X\+, 2X",
        ),
    ],
)
def test_messages_name_functions_of_correlation_by_their_name(tmp_path, pairs, options, words):
    path = universal(tmp_path / "a.unv", pairs)
    with pytest.raises(InputError, match=words):
        read_correlation(path, ReadOptions(**options))


def test_a_file_with_spectra_too_asks_which(tmp_path):
    path = universal(tmp_path / "a.unv", TO_SECOND)
    path.write_text(path.read_text() + function(0, 1, 0.0, LAGS[:, 0, 1], 3, time=(18, "Hz")))
    with pytest.raises(InputError, match=r"say which by .*kind"):
        modes_of_file(path)
    resembles(modes_of_file(path, read=ReadOptions(kind="correlation")).modes)


@pytest.mark.parametrize("sides", [ONE_SIDED, WRAPPED])
@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
def test_arrays_are_functions_by_their_kind(tmp_path, suffix, sides):
    values = np.moveaxis(np.array([[of_pair(i, j, sides)[1] for j in (0, 1)] for i in range(3)]), -1, 0) / GRAVITY**2
    path = tmp_path / f"a{suffix}"
    if suffix == ".npz":
        np.savez(path, r=values)
    elif suffix == ".mat":
        from scipy.io import savemat

        savemat(path, {"r": values})
    else:
        import h5py

        with h5py.File(path, "w") as file:
            file["r"] = values
    options = ReadOptions(
        kind="correlation", array="r", sampling_rate=RATE, channels="1X,2X,3X", inputs="1X,2X", units="g"
    )
    record = read_correlation(path, options)
    assert record.values == pytest.approx(LAGS[:, :, :2])
    assert record.quantities == ("acceleration",) * 3
    resembles(modes_of_file(path, read=options).modes)
    for missing in ("sampling_rate", "channels", "units"):
        given = {name: getattr(options, name) for name in options.given() if name != missing}
        with pytest.raises(InputError, match=missing):
            read_correlation(path, ReadOptions(**given))


def record(values=LAGS, **changes):
    parts = {"sampling_rate": RATE, "channels": ("1X", "2X", "3X"), "references": ("1X", "2X", "3X")}
    return CorrelationRecord(**parts | {"values": values, "quantities": ("displacement",) * 3} | changes)


def test_methods_agree_on_one_record():
    resembles(identify_modes(record(), "ssi_cov", orders=[6]))
    peaks = identify_modes(record(), "fdd", frequencies=FREQUENCY)
    assert peaks.frequency == pytest.approx(FREQUENCY, abs=RATE / N_LAGS / 2)
    enhanced = identify_modes(record(), "efdd", frequencies=FREQUENCY)
    assert enhanced.frequency == pytest.approx(FREQUENCY, rel=1e-3)
    assert enhanced.damping_ratio == pytest.approx(RATIO, rel=0.05)
    assert np.isnan(enhanced.std).all()
    with pytest.raises(InputError, match=r"with all channels as references, 3X\+ too"):
        identify_modes(record(LAGS[:, :, :2], references=("1X", "2X")), "efdd", frequencies=FREQUENCY)
    with pytest.raises(InputError, match="`method` must be ssi_cov or efdd or fdd"):
        identify_modes(record(), "pencil")
    with pytest.raises(InputError, match="`orders` must lie from 1 to"):
        identify_modes(record(), orders=[100000])


def test_references_may_stand_in_another_order():
    turned = record(LAGS[:, :, [2, 0, 1]], references=("3X", "1X", "2X"))
    resembles(identify_modes(turned))
    assert identify_modes(turned, "efdd", frequencies=FREQUENCY).damping_ratio == pytest.approx(RATIO, rel=0.05)


@pytest.mark.parametrize("n_lags, window", [(1500, "none"), (320, "hann"), (640, "hann")])
def test_damping_from_spectra_holds_for_either_window(n_lags, window):
    """Expected spectra of averages: the transform of the correlation times that of the window with itself."""
    n, lags = 2 * n_lags, system(n_lags)[3]
    weight = np.ones(n_lags)
    if window == "hann":
        taper = np.sin(np.pi * np.arange(n) / n) ** 2
        weight = np.correlate(taper, taper, "full")[n - 1 : n - 1 + n_lags] / (taper @ taper)
    half = np.fft.rfft(lags * np.where(np.arange(n_lags) == 0, 0.5, weight)[:, None, None], n, axis=0)
    spectra = half + half.conj().transpose(0, 2, 1)
    dofs = ("1X", "2X", "3X")
    stored = SpectrumRecord(np.fft.rfftfreq(n, 1 / RATE), spectra, dofs, dofs, ("displacement",) * 3, averages=100)
    modes = identify_modes(stored, frequencies=FREQUENCY)
    assert modes.frequency == pytest.approx(FREQUENCY, rel=1e-3)
    assert (np.abs(modes.damping_ratio - RATIO) < 2 * modes.std[3:]).all()
    assert (modes.std[3:] < 0.25 * RATIO).all()


@pytest.mark.long
def test_deviations_of_damping_are_those_of_repeats():
    """Averaged periodograms of simulated motion, as another program makes them."""
    from scipy import signal

    z, n, segment, rate, dofs = [], 40_000, 2048, 200.0, ("1X", "2X", "3X")
    inverse = np.linalg.inv(MASS)
    state = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ STIFFNESS, -inverse @ DAMPING]])
    step = linalg.expm(state / rate)
    force = np.vstack([np.zeros((3, 3)), inverse])
    covariance = linalg.solve_continuous_lyapunov(state, -force @ force.T)
    root = np.linalg.cholesky(covariance - step @ covariance @ step.T)  # of the noise that a step adds
    values, vectors = np.linalg.eig(step)
    for seed in range(12):
        noise = np.random.default_rng(seed).standard_normal((n, 6)) @ (np.linalg.inv(vectors) @ root).T
        parts = [signal.lfilter([1.0], [1.0, -value], noise[:, k]) for k, value in enumerate(values)]
        motion = (np.array(parts).T @ vectors.T).real[:, :3]
        spectra = [
            [signal.csd(motion[:, j], motion[:, i], rate, "hann", segment, segment // 2)[1] for j in range(3)]
            for i in range(3)
        ]
        averages = round(0.9 * (2 * n / segment - 1))
        lines = np.fft.rfftfreq(segment, 1 / rate)
        stored = SpectrumRecord(lines, np.moveaxis(spectra, -1, 0), dofs, dofs, ("displacement",) * 3, averages)
        modes = identify_modes(stored, frequencies=FREQUENCY)
        z.append((np.append(modes.frequency, modes.damping_ratio) - np.append(FREQUENCY, RATIO)) / modes.std)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.35)
    assert np.abs(z).max() < 4.5


def test_the_command_finds_modes_in_stored_correlation_functions(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    universal(tmp_path / "a.unv", TO_SECOND)
    result = CliRunner().invoke(app, ["modes", "a.unv", "--out", "out", "--no-report"])
    words = " ".join(result.output.split())
    assert result.exit_code == 0, result.output
    assert "stored correlation functions of 3 channels of displacement and 1 reference" in words
    assert "the mean product of the response at t + lag and the reference at t" in words
    assert '"kind": "correlation functions"' in (tmp_path / "out" / "modes.json").read_text()
    assert CliRunner().invoke(app, ["modes", "a.unv", "--rate", "50", "--out", "out2"]).exit_code == 2


def test_an_exponential_window_is_taken_off(tmp_path):
    path = tmp_path / "a.unv"
    decay = np.exp(-np.arange(N_LAGS) / RATE / 2.0)
    path.write_text("".join(function(i, 1, 0.0, LAGS[:, i, 1] * decay, 8) for i in range(3)))
    resembles(modes_of_file(path, ModesOptions(window=2.0)).modes)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"values": LAGS[:8]}, "at least 16 lags"),
        ({"values": LAGS[:, :2]}, "`values` must have shape"),
        ({"sampling_rate": 0.0}, "`sampling_rate` must be"),
        ({"references": ("4X", "1X", "2X")}, "`references` must be among the channels"),
        ({"averages": 0}, "`averages` must be at least 1"),
        ({"values": LAGS * [[[np.nan, 1, 1]]]}, "`values`"),
    ],
)
def test_records_of_correlation_functions_are_checked(changes, words):
    with pytest.raises(InputError, match=words):
        record(**changes)


def test_drawn_errors_have_the_covariance_of_bartlett():
    """Sums over lags of exact functions, 50 averages: 1500 draws tell a variance to 4 %, the taper takes less than 3 %."""
    forward = system(2 * N_LAGS)[3][::2]
    lags = np.concatenate([forward[:0:-1].transpose(0, 2, 1), forward])
    zero, size, at = N_LAGS - 1, np.sqrt(np.einsum("kii->i", forward[:1])), np.arange(-250, 251)
    errors = np.array(list(drawn_errors(forward, 50, 1500)))
    for i, j, k, p, q, m in ((0, 0, 5, 0, 0, 5), (1, 2, 3, 1, 2, 9), (0, 1, 20, 2, 1, 14), (2, 2, 40, 2, 2, 38)):
        first = lags[zero + at, i, p] * lags[zero + at + m - k, j, q]
        second = lags[zero + at + m, i, q] * lags[zero + at - k, j, p]
        expected = (first + second).sum() / (50 * N_LAGS)
        drawn = np.mean(errors[:, k, i, j] * errors[:, m, p, q])
        scale = size[i] * size[j] * size[p] * size[q] / 1000
        assert abs(drawn - expected) <= 0.12 * max(abs(expected), scale), (i, j, k, p, q, m)


def test_ssi_of_correlation_functions_states_deviations_where_averages_and_references_are_known():
    """Of exact functions 60 and 240 averages halve the deviations; frequencies as certain as Au's law of long records."""
    channels = ["1X", "2X", "3X"]

    def stated(averages, references=channels):
        columns = [channels.index(name) for name in references]
        quantities = ("displacement",) * 3
        return identify_modes(CorrelationRecord(RATE, LAGS[:, :, columns], channels, references, quantities, averages))

    few, many = stated(60), stated(240, channels[::-1])
    np.testing.assert_allclose(many.std, few.std / 2, rtol=0.2)
    least = np.sqrt(RATIO * FREQUENCY / (2 * np.pi * 60 * N_LAGS / RATE))
    assert (few.frequency_std > 0.9 * least).all()
    assert (few.frequency_std < 2 * least).all()
    assert (few.shape_std > 1e-9).sum() == 6
    assert stated(None).covariance is None
    assert stated(60, channels[:2]).covariance is None
    assert any("of all channels with all channels" in words for words in stated(60, channels[:2]).warnings)
