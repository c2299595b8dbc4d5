"""Records of a study beside its model: MAC and FRAC as dense computations have them, pairs, and what is said of them."""

from pathlib import Path

import mast
import numpy as np
import pytest
from scipy import sparse

from short_record_cases import chain, chain_tables, unknowns
from structid import (
    InputError,
    ModalRecord,
    PointMass,
    Spring,
    Structure,
    TimeRecord,
    correlated_modes,
    frac,
    from_matrices,
    load_study,
    simulated_time_record,
    write_record,
)
from structid.compare.correlation import correlate, correlation_summary, expanded_record
from structid.dynamics.normal_modes import modes
from structid.forward import TimeOptions
from structid.modal.formats.files import read_modes
from structid.report.correlation import before_and_after, modes_table
from structid.study.results.folder import write_results
from structid.study.run.run import run_study
from study_cases import write_chain

SIERRA = Path(__file__).parents[3] / "shared" / "data" / "sierra_block_ac_KM"
FRAMES = Path(__file__).parents[3] / "shared" / "data" / "smu_shear_frames" / "four_story_lab_frame.npz"


def dense_mac(x, y):
    return np.array([[abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a) * np.vdot(b, b)).real for b in y.T] for a in x.T])


def test_modes_of_a_study_are_paired_across_a_crossing_and_their_mac_is_the_dense_one(tmp_path):
    found = correlate(load_study(mast.written(tmp_path)))
    (part,) = found.modes
    structure = mast.mast()
    model = modes(structure.matrix("mass"), structure.matrix("stiffness"))
    measured = read_modes(tmp_path / "modes.csv")
    expected = dense_mac(measured.mode_shapes, mast.seen(structure, model))
    moving = part.pairing.mac.max(axis=0) > 0
    assert moving.sum() > 10
    assert part.pairing.mac[:, moving] == pytest.approx(expected[:, moving], abs=1e-12)
    assert part.pairing.number.tolist() == [1, 0, 3, 2]  # the model bends along Y first, the mast along X
    stiffer = np.sqrt(1 / 1.2) - 1
    assert part.frequency_difference == pytest.approx([0, stiffer, 0, stiffer], abs=1e-4)
    assert part.ecomac.max() < 0.03
    left = part.shapes - part.seen @ part.coefficients
    for i, k in enumerate(part.pairing.number):
        assert part.seen[:, k] @ left[:, i] == pytest.approx(0, abs=1e-9)  # the nearest of all factors
    assert found.warnings == ()


def test_macs_have_the_deviation_of_repeated_measurements():
    spring = Spring("spring", ["0X", "1X", "2X", "3X"], ["1X", "2X", "3X", "4X"], stiffness=[3e5, 2e5, 2e5, 1e5])
    nodes, masses = {i: 1.0 * i for i in range(5)}, PointMass("mass", [1, 2, 3, 4], 10.0)
    structure = Structure(nodes, [masses, spring], ["0X"], active=["X"])
    shapes = modes(structure.matrix("mass"), structure.matrix("stiffness")).mode_shapes[:, :2]
    shapes = shapes / np.abs(shapes).max(axis=0)
    true = shapes + np.array([[0.2, 0.0], [-0.2, 0.3], [0.0, 0.3], [0.1, -0.2]])  # of no model
    rng = np.random.default_rng(3)
    std = np.array([[0.02], [0.05], [0.03], [0.04]])[:, [0, 0]]
    names = [f"{i}X" for i in (1, 2, 3, 4)]

    def measured(values, errors=None):
        return ModalRecord([10.0, 25.0], np.full(2, np.nan), values, names, shape_std=errors)

    part = correlated_modes(structure, structure.values, measured(true, std))
    found, number = part.mac_of_pairs, part.pairing.number
    assert number.tolist() == [0, 1]
    assert found.value == pytest.approx(part.pairing.mac[[0, 1], number], abs=1e-12)
    drawn = true + std * rng.standard_normal((4000, 4, 2))
    model = shapes / np.linalg.norm(shapes, axis=0)
    repeated = np.einsum("rcm,cm->rm", drawn, model) ** 2 / np.sum(drawn**2, axis=1)
    assert found.std == pytest.approx(repeated.std(axis=0), rel=0.12)
    assert found.noise_effect == pytest.approx(repeated.mean(axis=0) - found.value, abs=0.15 * found.std.min())
    assert " \u00b1 " in modes_table(part).rows[0][5]
    bare = correlated_modes(structure, structure.values, measured(true))
    assert np.isnan(bare.mac_of_pairs.std).all()
    assert modes_table(bare).rows[0][5] == f"{bare.pairing.mac[0, 0]:.3f}"
    unknown = std.copy()
    unknown[1, 1] = np.nan
    half = correlated_modes(structure, structure.values, measured(true, unknown))
    assert half.mac_of_pairs.value == pytest.approx(found.value)
    for stated, of_whole in (
        (half.mac_of_pairs.std, found.std),
        (half.mac_of_pairs.noise_effect, found.noise_effect),
    ):
        assert np.isnan(stated[1])  # no error of an entry is no error of 0
        assert stated[0] == pytest.approx(of_whole[0], rel=0.15)
    assert modes_table(half).rows[1][5] == f"{half.pairing.mac[1, 1]:.3f}"
    seen = true.copy()
    seen[1, 1] = np.nan
    missing = correlated_modes(structure, structure.values, measured(seen, unknown))
    assert np.isfinite(missing.mac_of_pairs.std).all()  # an unknown entry needs no error


def test_at_identified_values_the_model_agrees(tmp_path):
    study = load_study(mast.written(tmp_path))
    result = run_study(study)
    write_results(result, tmp_path)
    (part,) = correlate(study, at=tmp_path).modes
    assert part.pairing.number.tolist() == [0, 1, 2, 3]
    assert np.abs(part.frequency_difference).max() < 2e-3
    ((before, after),), none = before_and_after(result.identification)
    assert none == ()
    assert before.pairing.number.tolist() == [1, 0, 3, 2]
    assert after.pairing.mac == pytest.approx(part.pairing.mac, abs=1e-12)
    with pytest.raises(InputError, match="none of the study's parameters"):
        correlate(load_study(write_chain(tmp_path / "chain")), at=tmp_path)


def test_responses_of_a_study_have_the_frac_of_its_model(tmp_path):
    study = load_study(write_chain(tmp_path))
    (part,) = correlate(study).responses
    values = study.parameters.values(study.parameters.start)
    m, c, k, h = (
        study.structure.matrix(law, values).toarray() for law in ("mass", "damping", "stiffness", "structural_damping")
    )
    s, b = (study.structure.selection(dofs).toarray() for dofs in (part.record.outputs, part.record.inputs))
    expected = []
    for f in part.record.frequency:
        w = 2 * np.pi * f
        expected.append(-(w**2) * s.T @ np.linalg.solve(k + 1j * h + 1j * w * c - w**2 * m, b))
    assert part.model == pytest.approx(np.array(expected), rel=1e-9)
    assert part.frac == pytest.approx(frac(part.record.values, np.array(expected)), abs=1e-12)
    assert part.fdac.shape == (len(part.record.inputs), 90, 90)
    summary = correlation_summary(correlate(study))
    assert summary["response_records"][0]["frac"][0]["frac"] == pytest.approx(part.frac[0, 0])


def changed(folder, change):
    """The correlation of the mast with measured shapes that `change` has changed."""
    study = load_study(mast.written(folder))
    record = study.setups[0].record.modes.load()
    shapes = record.mode_shapes.copy()
    change(shapes)
    other = ModalRecord(record.frequency, record.damping_ratio, shapes, record.channels)
    return correlated_modes(study.structure, study.parameters.values(study.parameters.start), other)


def test_a_sensor_that_is_turned_round_is_named(tmp_path):
    def turn(shapes):
        shapes[1] *= -1

    assert any(words.startswith("102X+ reads with the opposite sense") for words in changed(tmp_path, turn).warnings)
    assert not any("opposite" in words for words in changed(tmp_path, lambda shapes: None).warnings)


@pytest.mark.parametrize("turned", range(4))
def test_a_turned_sensor_is_named_where_it_costs_pairs(tmp_path, turned):
    """Of four sensors one that is turned round leaves no or wrong pairs to hold it against."""
    study = load_study(mast.written(tmp_path))
    record = study.setups[0].record.modes.load()
    shapes = record.mode_shapes[:4].copy()
    shapes[turned] *= -1
    few = ModalRecord(record.frequency, record.damping_ratio, shapes, record.channels[:4])
    part = correlated_modes(study.structure, study.parameters.values(study.parameters.start), few)
    (told,) = (words for words in part.warnings if "opposite" in words)
    assert told.startswith(f"{record.channels[turned]} reads with the opposite sense")


def test_pairs_that_the_frequency_refuses_are_told_as_such(tmp_path):
    """As where the model's stiffness is a hundred times too small: shapes agree, frequencies do not."""
    study = load_study(mast.written(tmp_path))
    record = study.setups[0].record.modes.load()
    off = ModalRecord(10 * record.frequency, record.damping_ratio, record.mode_shapes, record.channels)
    part = correlated_modes(study.structure, study.parameters.values(study.parameters.start), off)
    assert part.n_paired == 0
    (told,) = (words for words in part.warnings if "measured at" in words)
    assert "too far off in frequency" in told
    assert "`frequency_guard`" in told
    assert "MAC" not in told
    assert part.remark(0).endswith("MAC 1.00, too far off in frequency")


def test_a_mode_without_a_like_is_told(tmp_path):
    def spoil(shapes):
        shapes[:, 3] = [1.0, -1.0, 1.0, 1.0, -1.0, -1.0]

    part = changed(tmp_path, spoil)
    assert part.pairing.missing.tolist() == [3]
    assert part.remark(3).startswith("missing in the model: nearest is mode")
    assert any("no mode of the model matches the modes measured at" in words for words in part.warnings)
    assert not np.abs(part.coefficients[:, 3]).any()


def test_expanded_shapes_are_a_record_that_is_read_back(tmp_path):
    (part,) = correlate(load_study(mast.written(tmp_path))).modes
    record = expanded_record(part)
    assert len(record.channels) == 48
    row = record.channels.index(mast.Dof(4, "X"))
    other = record.channels.index(mast.Dof(4, "Y"))
    seen = (record.mode_shapes[row] + record.mode_shapes[other]) / np.sqrt(2)
    assert seen == pytest.approx(part.shapes[0], abs=0.06)
    assert (np.abs(seen - part.shapes[0]) < 4 * part.expanded.noise[0]).all()


@pytest.mark.skipif(not FRAMES.exists(), reason="the measured frames (GPL) are not part of the package")
def test_a_measured_frame_of_four_storeys_is_paired_at_published_stiffnesses():
    """Modes 3 and 4, which the authors did not use, within 0.8 % of the published stiffnesses' (see the set's README)."""
    from structid import PointMass, Spring, Structure

    data, inch = np.load(FRAMES), 175.12683524647636
    stiffness = np.array([7.397, 7.841, 8.717, 15.327]) * inch
    nodes = {k: (0.0, 0.3 * k) for k in range(1, 5)}
    springs = [Spring("ground", "1X", stiffness=stiffness[0])]
    springs += [Spring("storeys", ["1X", "2X", "3X"], ["2X", "3X", "4X"], stiffness=stiffness[1:])]
    frame = Structure(nodes, [PointMass("floors", [1, 2, 3, 4], 12.060 * 0.45359237), *springs], active=["X"])
    record = ModalRecord(
        data["test_frequency_hz"], np.full(4, np.nan), data["test_mode"], [f"{k}X" for k in range(1, 5)]
    )
    part = correlated_modes(frame, frame.values, record)
    assert part.pairing.number.tolist() == [0, 1, 2, 3]
    assert np.abs(part.frequency_difference).max() < 0.008
    dense = dense_mac(data["test_mode"], part.seen)
    assert part.pairing.mac == pytest.approx(dense, abs=1e-12)
    assert dense[0, 0] > 0.99


@pytest.mark.skipif(not SIERRA.exists(), reason="the Sierra/SD matrices (GPL) are not part of the package")
def test_modes_of_another_code_are_those_of_its_matrices():
    """A free block of 3,390 degrees of freedom: 8 elastic modes at 40 sensors, as the code that made the matrices has them."""
    mesh = dict(np.load(SIERRA / "mesh_and_reference_modes.npz"))
    rows = mesh["dof_of_node_xyz_zero_based"]
    lower = [sparse.load_npz(SIERRA / f"{name}aa_lower.npz") for name in "KM"]
    stiffness, mass = (sparse.csc_array(half + half.T - sparse.diags_array(half.diagonal())) for half in lower)
    names = np.empty(rows.size, dtype=object)
    for axis, direction in enumerate("XYZ"):
        names[rows[:, axis]] = [f"{k}{direction}" for k in range(1, len(rows) + 1)]
    block = from_matrices(
        {"block": {"mass": mass, "stiffness": stiffness}}, names.tolist(), dict(enumerate(mesh["xyz_m"], 1))
    )
    rng = np.random.default_rng(6)
    chosen = [
        (int(n), int(a)) for n, a in zip(rng.choice(len(rows), 40, replace=False), rng.integers(0, 3, 40), strict=True)
    ]
    shapes = np.array(
        [[mesh["reference_shapes_first20"][r, n, a] for r in range(6, 14)] for n, a in chosen], dtype=float
    )
    record = ModalRecord(
        mesh["reference_freq_hz"][6:14], np.full(8, np.nan), shapes, [f"{n + 1}{'XYZ'[a]}" for n, a in chosen]
    )
    part = correlated_modes(block, block.values, record)
    assert np.abs(part.frequency_difference).max() < 1e-5
    pairs = part.pairing.mac[np.arange(8), part.pairing.number]
    assert pairs == pytest.approx(np.ones(8), abs=1e-6)
    moving = part.pairing.mac.max(axis=0) > 0
    assert part.pairing.mac[:, moving] == pytest.approx(dense_mac(shapes, part.seen[:, moving]), abs=1e-12)
    assert part.self_orthogonality is not None


MIXED = (
    chain_tables(2.0, 1000.0, 0.7)
    + """
[[unknown]]
property = "stiffness"
elements = "k"
[record]
path = "mixed.npz"
"""
)


@pytest.mark.parametrize("way", ["[record.time]\nrelative_noise = 0.001\n", "[record.frf]\nsegment_length = 4000\n"])
def test_every_sensor_of_a_record_of_mixed_quantities_is_held_beside_the_model(tmp_path, way):
    (tmp_path / "mixed.toml").write_text(MIXED + way)
    structure, n = chain(), 4000
    values = np.column_stack([np.random.default_rng(0).standard_normal(n), np.zeros((n, 4))])
    places, kinds = (
        ("4X", "1X", "2X", "3X-", "4X"),
        ("force", "displacement", "velocity", "acceleration", "acceleration"),
    )
    blank = TimeRecord(40.0, np.concatenate([values, np.zeros_like(values)]), places, kinds)
    record = simulated_time_record(structure, unknowns(structure), blank, TimeOptions(force="first"))
    write_record(tmp_path / "mixed.npz", record)
    (part,) = correlate(load_study(tmp_path / "mixed.toml")).responses
    assert part.record.kind == "accelerance"
    assert [str(dof) for dof in part.record.outputs] == ["1X+", "2X+", "3X-", "4X+"]
    band = (part.record.frequency > 1) & (part.record.frequency < 6)
    ratio = part.record.values[band, :, 0] / part.model[band, :, 0]
    assert np.median(ratio.real, axis=0) == pytest.approx(
        1, abs=0.05
    )  # resonances leak; no factor of i omega is missing
    assert np.median(ratio.imag, axis=0) == pytest.approx(0, abs=0.05)
