"""A study run and checked: values, predicted accuracy, and records that cannot be used."""

from __future__ import annotations

import numpy as np
import pytest

from structid.core.errors import InputError, SingularModelError
from structid.inversion import Status
from structid.records import TimeRecord
from structid.records.formats import write_record
from structid.study.run.check import check_study
from structid.study.run.run import run_study
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study
from study_cases import (
    CHAIN,
    NOISE,
    RIGID,
    TRUE,
    bare,
    chain_record,
    exact_frf,
    free_text,
    line_of,
    record_from_zero,
    replaced,
    rigid_record,
    with_nan,
    write_chain,
)


def test_a_study_finds_the_values_that_made_its_record(tmp_path):
    result = run_study(load_study(write_chain(tmp_path)))
    estimate = result.identification.estimate
    assert estimate.status is Status.CONVERGED
    assert set(estimate.names) == set(TRUE)
    for name, true in TRUE.items():
        value, std = estimate[name].value, float(estimate.std_noise[estimate.names.index(name)])
        assert abs(value - true) < 5 * std, name  # 8 Gaussian parameters: a false alarm in 2e5 seeds
        assert 0 < std < 0.01 * true, name  # 1 % noise on 230 lines
    assert result.identification.mass.total == pytest.approx(6.0, abs=5 * result.identification.mass.std)


def physical_jacobian(values: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """Central differences of the chain's FRF, from its matrices written out, in the order of TRUE."""

    def frf(p: np.ndarray) -> np.ndarray:
        m1, m2, m3, ground, first, second, loss, dashpot = p
        stiffness = np.array([[ground + first, -first, 0], [-first, first + second, -second], [0, -second, second]]) * (
            1 + 1j * loss
        )
        omega = 2 * np.pi * frequency[:, None, None]
        dynamic = stiffness + 1j * omega * np.diag([dashpot, 0, 0]) - omega**2 * np.diag([m1, m2, m3])
        return -(omega**2) * np.linalg.inv(dynamic)[:, [0, 2], :][:, :, [2]]

    columns = []
    for i, value in enumerate(values):
        step = np.zeros(len(values))
        step[i] = 1e-5 * value
        columns.append((frf(values + step) - frf(values - step)).ravel() / (2e-5 * value))
    return np.array(columns).T


def test_the_predicted_deviations_are_the_cramer_rao_bound(tmp_path):
    """The bound is that of the noise: the study says that its model and the gain of its record are exact."""
    exact = replaced(
        "[structure]\n", "[structure]\ntolerance = 0\n", replaced("[record]\n", "[record]\ncalibration = 0\n")
    )
    result = check_study(load_study(write_chain(tmp_path, exact)))
    record = chain_record()
    values = np.array([2.4, 2.4, 1.2, 1200.0, 900.0, 900.0, 0.03, 2.0])
    jacobian = physical_jacobian(values, record.frequency)
    per_part = NOISE * np.abs(record.values).ravel() / np.sqrt(2)
    whitened = jacobian / per_part[:, None]
    information = (whitened.conj().T @ whitened).real
    bound = np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(result.std, bound, rtol=1e-6)  # differences are good to 1e-9, inversion costs 1e4
    gradient = np.array([1.0, 1, 1, 0, 0, 0, 0, 0])
    assert result.total_mass_std == pytest.approx(np.sqrt(gradient @ np.linalg.inv(information) @ gradient), rel=1e-6)
    assert result.total_mass == pytest.approx(6.0)
    assert result.determined


def test_a_prior_counts_as_data_in_the_prediction(tmp_path):
    text = replaced('elements = "mass 1"', 'elements = "mass 1"\nprior = {mean = 2.0, std = 1e-6}')
    assert check_study(load_study(write_chain(tmp_path, text))).std[0] == pytest.approx(1e-6, rel=1e-3)


def test_check_tells_sensors_lines_and_modes(tmp_path):
    text = replaced("band = [0.5, 12.0]", "band = [2.0, 12.0]")
    result = check_study(load_study(write_chain(tmp_path, text, chain_record(outputs=("1X-", "3X")))))
    assert [(c.channel, c.role, c.seen) for c in result.channels] == [
        ("1X-", "output", "-1X"), ("3X+", "output", "+3X"), ("3X+", "input", "+3X")
    ]  # fmt: skip
    (words,) = result.records
    assert words == "accelerance in (m/s^2)/N, 200 of 230 lines from 2 to 11.95 Hz, noise: declared"
    assert [mode.in_band for mode in result.modes] == [False, True, True]
    second = result.modes[1]
    assert second.lines_per_bandwidth == pytest.approx(2 * second.damping_ratio * second.frequency / 0.05, rel=1e-6)
    windowed = replaced('path = "frf.npz"', 'path = "frf.npz"\nwindow_decay = 0.5')
    wider = check_study(load_study(write_chain(tmp_path / "windowed", windowed))).modes[1]
    assert wider.lines_per_bandwidth == pytest.approx(second.lines_per_bandwidth + 0.5 / np.pi / 0.05, rel=1e-6)


def test_a_sensor_tied_by_a_constraint_is_seen_through_it(tmp_path):
    text = replaced(
        "[[unknown]]",
        '[[structure.constraint]]\nname = "lever"\ndependent = "3X"\ndepends_on = [["2X", 0.5]]\n[[unknown]]',
    )
    seen = {c.channel: c.seen for c in check_study(load_study(write_chain(tmp_path, text))).channels}
    assert seen == {"1X+": "+1X", "3X+": "+0.5 2X"}


def test_masses_on_one_rigid_body_are_told_only_as_a_sum(tmp_path):
    study = load_study(write_chain(tmp_path, RIGID, rigid_record()))
    result = check_study(study)
    assert not result.determined
    assert result.identifiability.rank == study.parameters.n_params - 1
    assert "mass[mass 2] and mass[mass 3] only as a sum" in " ".join(result.warnings)
    assert np.isnan(result.std[1:3]).all()
    assert np.isfinite(result.std[3:]).all()


def histories(folder, keys: str, more: str = "") -> str:
    """A study on bare time histories."""
    np.savez(folder / "bare.npz", t=np.ones((500, 2)))
    told = f'path = "bare.npz"\nsampling_rate = 50.0\nchannels = ["1X", "3X"]\n{keys}'
    frf = f'[record.frf]\nestimator = "H1"\nsegment_length = 64\n{more}'
    return replaced("[record.noise]\nrelative = 0.01\n", frf, replaced('path = "frf.npz"', told))


def wrong_frequency(axis: np.ndarray) -> np.ndarray:
    axis = axis.copy()
    axis[100] = axis[98]
    return axis


def test_a_bare_array_is_read_by_the_names_of_read_options(tmp_path):
    ready = prepare_study(load_study(write_chain(tmp_path, bare(tmp_path))))
    np.testing.assert_array_equal(ready.setups[0].record.values, chain_record().values)


RECORDS = [
    (lambda f: bare(f, h=with_nan(chain_record().values[:, :, 0])), "path", ["bare.npz", "NaN", "remove"]),
    (lambda f: bare(f, h=chain_record().values[:, :, 0] * np.inf), "path", ["bare.npz", "infinite", "remove"]),
    (lambda f: bare(f, f=wrong_frequency(chain_record().frequency)), "path", ["must increase", "index 100", "sort"]),
    (lambda f: bare(f).replace('["1X", "3X"]\ninputs', '["1X", "1X"]\ninputs'), "path", ["1X+ twice"]),
    (lambda f: bare(f).replace('["1X", "3X"]\ninputs', '["1X", "8X"]\ninputs'), "outputs", ["8X+ is at node 8"]),
    (lambda f: bare(f).replace('inputs = ["3X"]', 'inputs = ["3Y"]'), "inputs", ["3Y+ is not part", "moves in 3X"]),
    (lambda f: bare(f).replace('array = "h"', 'array = "g"'), "path", ["bare.npz", "'g'"]),
    (lambda f: bare(f).replace('"accelerance"', '"inertance"'), "kind", ["bare.npz: `kind` must be one of receptance"]),
    (lambda f: bare(f).replace('kind = "acc', 'unit = "mm/N"\nkind = "acc'), "kind", ["is of receptance, but `kind` says"]),
    (lambda f: bare(f).replace('kind = "accelerance"', 'unit = "ell/N"'), "unit", ["bare.npz: cannot read 'ell/N'"]),
    (lambda f: bare(f).replace('["1X", "3X"]', '["1X", "Q"]'), "outputs", ["bare.npz: cannot read 'Q'"]),
    (lambda f: replaced('"frf.npz"', '"frf.npz"\nkind = "mobility"'), "kind", ["frf.npz: says kind accelerance"]),
    (lambda f: replaced('"frf.npz"', '"frf.npz"\nunits = "g"'), "units", ["frf.npz: holds frequency response functions"]),
    (lambda f: histories(f, 'quantities = ["speed", "force"]'), "quantities", ["bare.npz: `quantities` must be among"]),
    (lambda f: histories(f, 'units = ["g", "ell"]'), "units", ["bare.npz: cannot read 'ell'"]),
    (lambda f: histories(f, 'units = ["g"]\nquantities = "force"'), "quantities", ["1X+ has a unit of acceleration"]),
    (
        lambda f: histories(f, 'units = ["g", "N"]', 'quantity = "velocity"'),
        "quantity",
        ["no channel of the record is of velocity; they are of acceleration, force"],
    ),
    (lambda f: replaced("[0.5, 12.0]", "[50.0, 60.0]"), "band", ["no frequency line", "widen the band"]),
    (
        lambda f: replaced("band =", "exclude = [[0.1, 6.0], [5.0, 20.0]]\nband ="),
        "exclude",
        ["leaves out every line of the band (230 from 0.5 to 11.95 Hz)", "leave out less"],
    ),
    (
        lambda f: replaced("band =", "evaluation_band = [50.0, 60.0]\nband ="),
        "evaluation_band",
        ["no frequency line", "widen the band"],
    ),
    (lambda f: replaced('"frf.npz"', '"frf.npz"\nchannels_used = ["2X"]'), "channels_used", ["no output 2X+", "1X+"]),
    (lambda f: replaced("relative = 0.01", "from_coherence = true"), "[record.noise]", ["coherence", "averages"]),
]  # fmt: skip


@pytest.mark.parametrize("make, place, words", RECORDS)
def test_a_record_that_cannot_be_used_is_placed(tmp_path, make, place, words):
    text = make(tmp_path)
    path = write_chain(tmp_path, text)
    with pytest.raises(InputError) as caught:
        run_study(load_study(path))
    message = str(caught.value)
    assert message.startswith(f"{path}, line {line_of(place if place[0] == '[' else place + ' =', text)}: ")
    for word in words:
        assert word in message


@pytest.mark.parametrize("suffix, keep", [(".uff", 3000), (".uff", 0), (".h5", 5000), (".h5", 0), (".npz", 2000)])
def test_a_truncated_or_empty_file_is_named(tmp_path, suffix, keep):
    write_record(tmp_path / f"cut{suffix}", chain_record())
    content = (tmp_path / f"cut{suffix}").read_bytes()
    assert len(content) > keep
    (tmp_path / f"cut{suffix}").write_bytes(content[:keep])
    text = replaced('"frf.npz"', f'"cut{suffix}"')
    with pytest.raises(InputError, match=rf"line {line_of('path =', text)}: \[record\] path: .*cut\{suffix}"):
        run_study(load_study(write_chain(tmp_path, text)))


@pytest.mark.parametrize(
    "scale, words",
    [
        (1e3, ["close to 10^3", "mm", "[record]"]),
        (1e-3, ["close to 10^-3"]),
        (1e6, ["close to 10^6"]),
        (9.81, ["close to 9.81", "read as g"]),
        (1 / 9.81, ["close to 1/9.81", "in g", 'unit = "g/N"']),
    ],
)
def test_units_that_contradict_the_model_are_told(tmp_path, scale, words):
    [warning] = prepare_study(load_study(write_chain(tmp_path, record=chain_record(scale=scale)))).channel_warnings
    for word in words:
        assert word in warning


def test_the_warning_of_units_comes_first_in_the_result(tmp_path):
    text = replaced("[method]", "[method]\nmax_iterations = 2\npole_free_start = false\nrestarts = 0")
    result = run_study(load_study(write_chain(tmp_path, text, chain_record(scale=1e3))))
    assert "different units" in result.identification.warnings[0]


@pytest.mark.parametrize("scale", [1.0, 0.5, 2.0])
def test_scales_that_the_start_may_explain_are_not_told(tmp_path, scale):
    assert prepare_study(load_study(write_chain(tmp_path, record=chain_record(scale=scale)))).channel_warnings == ()


@pytest.mark.parametrize("scale, words", [(3.0, "3.7 times what the record says"), (30.0, "37 times"), (0.2, "1/4")])
def test_other_scales_are_told_of_the_load_and_not_of_units(tmp_path, scale, words):
    [warning] = prepare_study(load_study(write_chain(tmp_path, record=chain_record(scale=scale)))).channel_warnings
    assert warning.startswith("load 3X+: the force is ")
    assert words in warning
    assert "different units" not in warning


def test_a_wrong_sign_at_the_driving_point_is_a_warning(tmp_path):
    ready = prepare_study(load_study(write_chain(tmp_path, record=chain_record(scale=-1.0))))
    assert any("driving point 3X+ / 3X+" in warning and "sign" in warning for warning in ready.warnings)
    assert prepare_study(load_study(write_chain(tmp_path))).warnings == ()


def test_a_free_structure_at_0_hz_needs_supports(tmp_path):
    text = free_text().replace("[0.5, 12.0]", "[0.0, 12.0]").replace("relative = 0.01", "absolute = 1.0")
    path = write_chain(tmp_path, text, record_from_zero())
    with pytest.raises(SingularModelError) as caught:
        run_study(load_study(path))
    assert str(caught.value).startswith(f"{path}, line {line_of('[structure]', text)}: [structure]: ")
    for word in ("singular at 0 Hz", "nothing holds 1X, 2X, 3X", "add supports", "band"):
        assert word in str(caught.value)
    prepare_study(load_study(write_chain(tmp_path, text.replace("[0.0, 12.0]", "[0.5, 12.0]"), record_from_zero())))


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda t: t.replace('active = ["X"]', 'active = ["X", "RZ"]').replace(
            "[[unknown]]", '[[structure.dashpot]]\nname = "loose"\nfirst = "2RZ"\nviscous_damping = 0.0\n[[unknown]]', 1),
         ["2RZ can move with neither mass nor stiffness", "fixed"]),
        (lambda t: t.replace("mass = 2.4", "mass = 0.0").replace("mass = 1.2", "mass = 0.0"), ["has no mass"]),
    ],
)  # fmt: skip
def test_a_mechanism_names_what_moves(tmp_path, change, words):
    text = change(CHAIN).replace(
        'property = "mass"\nelements = "mass 1"', 'property = "stiffness"\nelements = "ground"'
    )
    text = (
        text[: text.index("[[unknown]]")]
        + '[[unknown]]\nproperty = "stiffness"\nelements = "ground"\n'
        + text[text.index("[record]") :]
    )
    with pytest.raises(SingularModelError) as caught:
        run_study(load_study(write_chain(tmp_path, text)))
    for word in words:
        assert word in str(caught.value)


def test_repeats_give_the_noise_from_their_scatter(tmp_path):
    for seed in range(4):
        write_record(tmp_path / f"r{seed}.npz", chain_record(seed))
    text = replaced('path = "frf.npz"', 'repeats = ["r0.npz", "r1.npz", "r2.npz", "r3.npz"]')
    with pytest.raises(InputError, match="the noise comes from `repeats`"):
        load_study(write_chain(tmp_path, text))
    text = text.replace("[record.noise]\nrelative = 0.01\n", "")
    record = prepare_study(load_study(write_chain(tmp_path, text))).setups[0].record
    assert record.noise_source == "repeats"
    relative = np.sqrt(np.median(record.variance / np.abs(record.values) ** 2))
    assert relative == pytest.approx(NOISE / 2, rel=0.15)  # standard error of the mean of 4; the median is 8 % low


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (chain_record(kind="mobility"), "their kind: repeat 1 (r0.npz) has accelerance, where repeat 2 (r1.npz) has mobility"),
        (TimeRecord(9.0, np.ones((9, 1)), ["1X"], ["force"]), "r1.npz holds time histories and r0.npz frequency response"),
    ],
)  # fmt: skip
def test_repeats_that_differ_are_told_at_their_key(tmp_path, other, words):
    write_record(tmp_path / "r0.npz", chain_record())
    write_record(tmp_path / "r1.npz", other)
    text = replaced(
        "[record.noise]\nrelative = 0.01\n", "", replaced('path = "frf.npz"', 'repeats = ["r0.npz", "r1.npz"]')
    )
    with pytest.raises(InputError) as caught:
        prepare_study(load_study(write_chain(tmp_path, text)))
    assert f"line {line_of('repeats =', text)}: [record] repeats: " in str(caught.value)
    assert words in str(caught.value)


def test_noise_comes_from_coherence_and_averages(tmp_path):
    coherence = np.full((230, 2, 1), 0.99)
    text = replaced("relative = 0.01", "from_coherence = true\naverages = 20")
    record = prepare_study(load_study(write_chain(tmp_path, text, chain_record(coherence=coherence)))).setups[0].record
    np.testing.assert_allclose(record.variance, np.abs(record.values) ** 2 * 0.01 / (20 * 0.99), rtol=1e-12)
    silent = replaced("[record.noise]\nrelative = 0.01\n", "")
    told = (
        prepare_study(load_study(write_chain(tmp_path, silent, chain_record(coherence=coherence, averages=20))))
        .setups[0]
        .record
    )
    np.testing.assert_array_equal(told.variance, record.variance)


def test_channels_used_selects_sensors_whatever_their_sense(tmp_path):
    text = replaced('"frf.npz"', '"frf.npz"\nchannels_used = ["1X"]')
    record = (
        prepare_study(load_study(write_chain(tmp_path, text, chain_record(outputs=("1X-", "3X"))))).setups[0].record
    )
    assert [str(dof) for dof in record.outputs] == ["1X-"]


def time_record(n: int = 40_000) -> TimeRecord:
    """Random force on mass 3 and the accelerations that the exact FRF makes of one period of it."""
    random = np.random.default_rng(3)
    force = random.standard_normal(n)
    frequency = np.fft.rfftfreq(n, 1 / 50)
    frf = np.zeros((len(frequency), 2), complex)
    frf[1:] = exact_frf(frequency[1:], [0, 2], [2])[:, :, 0]
    motion = np.fft.irfft(frf * np.fft.rfft(force)[:, None], n, axis=0)
    values = np.column_stack([motion, force])
    return TimeRecord(50.0, values, ("1X", "3X", "3X"), ("acceleration", "acceleration", "force"))


def test_a_time_record_becomes_frequency_responses(tmp_path):
    write_record(tmp_path / "time.npz", time_record())
    frf = '[record.frf]\nestimator = "H1"\nsegment_length = 4096\n'
    text = replaced("[record.noise]\nrelative = 0.01\n", frf, replaced('"frf.npz"', '"time.npz"'))
    record = prepare_study(load_study(write_chain(tmp_path, text))).setups[0].record
    assert [str(dof) for dof in record.outputs] == ["1X+", "3X+"]
    assert [str(dof) for dof in record.inputs] == ["3X+"]
    near = np.abs(record.frequency - 3.3) < 0.3  # away from resonances, where leakage is small
    np.testing.assert_allclose(record.values[near], exact_frf(record.frequency[near], [0, 2], [2]), rtol=0.05)
    assert record.variance is not None
    with pytest.raises(InputError, match=r"\[record\]: the record holds time histories; add \[record.frf\]"):
        prepare_study(load_study(write_chain(tmp_path, text.replace(frf, ""))))
    with pytest.raises(InputError, match=r"\[record.frf\]: .*longer than the longest record"):
        prepare_study(load_study(write_chain(tmp_path, text.replace("4096", "409600"))))
    with pytest.raises(InputError, match=r"\[record.frf\]: the record holds frequency response functions already"):
        prepare_study(load_study(write_chain(tmp_path, text.replace("time.npz", "frf.npz"))))


def test_a_model_too_stiff_for_double_precision_is_told(tmp_path):
    weld = '[[structure.spring]]\nname = "weld"\nfirst = "2X"\nsecond = "3X"\nstiffness = 1e17\n[[structure.dashpot]]'
    study = load_study(write_chain(tmp_path, CHAIN.replace("[[structure.dashpot]]", weld)))
    words = "too stiff in places, for double precision"
    assert [words in warning for warning in check_study(study).warnings].count(True) == 1
    assert [words in warning for warning in run_study(study).identification.warnings].count(True) == 1
    plain = load_study(write_chain(tmp_path / "plain"))
    assert not any("double precision" in warning for warning in check_study(plain).warnings)
