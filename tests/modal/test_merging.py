"""Modes of several set-ups merged: exactness, weights, agreement, and the joint form's indifference to excitation."""

from dataclasses import replace

import numpy as np
import pytest
from modal_cases import ambient_chain, chain_modes

from structid import InputError, ModalRecord
from structid.dof import parse_dofs
from structid.modal.identification import identify_modes
from structid.modal.merging.joint_setups import joint_modes
from structid.modal.merging.joint_subspace import (
    JointSubspace,
    _parts,
    _split,
    joint_deviations,
    joint_poles,
    joint_subspace,
)
from structid.modal.merging.merging import merge_modes, merged_setups
from structid.modal.merging.setup_data import setup_data
from structid.modal.merging.shape_merging import merged_shape
from structid.modal.method import ModalOptions
from structid.records import TimeRecord
from structid.similarity import mac

SETUPS = (("1X", "4X", "2X"), ("1X", "4X", "3X"))
OPTIONS = ModalOptions(orders=[8], block_rows=12)


def part(names, frequency, shapes, std=1e-3, shape_std=0.01, scale=1.0):
    """One set-up's modes at some of four sensors."""
    rows = [int(name[0]) - 1 for name in names]
    sign = np.array([-1.0 if name.endswith("-") else 1.0 for name in names])
    own = shapes[rows] * sign[:, None] * scale
    largest = np.abs(own).argmax(axis=0)
    own = own / own[largest, np.arange(own.shape[1])]
    n = len(frequency)
    covariance = None if std is None else np.diag(np.full(2 * n, std**2))
    error = None if shape_std is None else np.full(own.shape, shape_std)
    return ModalRecord(frequency, np.full(n, 0.01), own, names, covariance, error)


def test_merging_puts_clean_parts_together_whatever_their_scale_and_senses():
    omega, shapes = chain_modes()
    first = part(SETUPS[0], omega, shapes, scale=2 + 1j)
    second = part(("4X-", "3X", "1X"), omega, shapes, scale=-0.3)
    found = merge_modes([first, second])
    assert [str(dof) for dof in found.channels] == ["1X+", "4X+", "2X+", "3X+"]
    order = [0, 3, 1, 2]
    np.testing.assert_allclose(np.diag(mac(found.mode_shapes, shapes[order])), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(found.mode_shapes).max(axis=0), 1.0)
    np.testing.assert_allclose(found.frequency, omega)
    np.testing.assert_allclose(np.diag(found.covariance), 0.5e-6)  # half the variance of one


def test_merging_weights_by_inverse_variances_and_states_the_spread():
    _, shapes = chain_modes()
    f = np.array([1.0, 2.0, 3.0, 4.0])
    sure, unsure = part(SETUPS[0], f, shapes, std=0.01), part(SETUPS[1], f + 0.05, shapes, std=0.02)
    found = merged_setups([sure, unsure])
    np.testing.assert_allclose(found.modes.frequency, f + 0.05 * 0.2)
    np.testing.assert_allclose(found.frequency_spread, 0.05 / np.sqrt(2))
    chi_square = 0.05**2 / (0.01**2 + 0.02**2)
    np.testing.assert_allclose(found.chi_square, chi_square)
    np.testing.assert_allclose(np.diag(found.modes.covariance)[:4], 1 / (1e4 + 2500))
    assert not found.modes.warnings


def test_merging_says_that_set_ups_disagree_and_widens_the_interval():
    _, shapes = chain_modes()
    f = np.array([1.0, 2.0, 3.0, 4.0])
    moved = f + np.array([0.0, 0.0, 0.1, 0.0])
    found = merged_setups([part(SETUPS[0], f, shapes, std=0.01), part(SETUPS[1], moved, shapes, std=0.01)])
    (note,) = found.modes.warnings
    assert note.startswith("mode 3: the set-ups disagree")
    assert "temperature" in note
    variance = np.diag(found.modes.covariance)[:4]
    np.testing.assert_allclose(variance[[0, 1, 3]], 0.5e-4)
    np.testing.assert_allclose(variance[2], 0.5e-4 * found.chi_square[2])
    np.testing.assert_allclose(found.chi_square[2], 50.0)


def test_merging_pairs_by_shape_where_frequencies_cross():
    _, shapes = chain_modes()
    f = np.array([1.0, 2.0, 3.0, 3.02])
    swapped = shapes[:, [0, 1, 3, 2]]
    found = merged_setups([part(SETUPS[0], f, shapes), part(SETUPS[1], f, swapped)])
    assert found.members[1].tolist() == [0, 1, 3, 2]


def test_merging_leaves_out_modes_that_a_set_up_lacks_and_names_them():
    omega, shapes = chain_modes()
    second = part(SETUPS[1], omega[[0, 1, 3]], shapes[:, [0, 1, 3]])
    found = merge_modes([part(SETUPS[0], omega, shapes), second])
    np.testing.assert_allclose(found.frequency, omega[[0, 1, 3]])
    assert f"set-up 1: {omega[2]:.4g} Hz are left out" in found.warnings[0]


def test_merging_without_covariance_gives_none():
    omega, shapes = chain_modes()
    found = merged_setups([part(names, omega, shapes, None, None) for names in SETUPS])
    assert found.modes.covariance is None
    assert found.modes.shape_std is None
    assert np.isnan(found.probability).all()


def test_merged_shape_has_the_deviations_of_repeated_measurements():
    rng = np.random.default_rng(3)
    truth = np.array([1.0, 0.6 + 0.1j, -0.4, 0.8, 0.3])
    index = [np.array([0, 1, 2]), np.array([0, 1, 3]), np.array([0, 1, 4])]
    errors = [np.array([0.01, 0.02, 0.01]), np.array([0.02, 0.01, 0.02]), np.array([0.01, 0.01, 0.01])]
    scales = [1.0, 1.5j, -0.7]
    clean, std = merged_shape([c * truth[i] for c, i in zip(scales, index, strict=True)], errors, index, 5)
    np.testing.assert_allclose(clean, truth, atol=1e-10)
    found = []
    for _ in range(200):
        noise = [e * (rng.standard_normal(3) + 1j * rng.standard_normal(3)) for e in errors]
        parts = [c * truth[i] + z for c, i, z in zip(scales, index, noise, strict=True)]
        shape, _ = merged_shape(parts, errors, index, 5)
        found.append((shape / shape[0]).real)
    np.testing.assert_allclose(np.std(found, axis=0)[1:], std[1:], rtol=0.2)  # 200 repeats: 5 % standard error
    assert std[0] == 0.0


@pytest.mark.parametrize(
    ("setups", "references", "words"),
    [
        ([("1X", "2X")], None, "two set-ups or more"),
        ([("1X", "2X"), ("3X", "4X")], None, "a sensor in common"),
        ([("1X", "2X"), ("1X", "4X")], ["2X"], r"2X\+ is not in set-up 2"),
    ],
)
def test_merging_names_what_is_missing(setups, references, words):
    omega, shapes = chain_modes()
    with pytest.raises(InputError, match=words):
        merge_modes([part(names, omega, shapes) for names in setups], references)


def test_merging_refuses_set_ups_without_a_mode_in_common():
    omega, shapes = chain_modes()
    with pytest.raises(InputError, match="no mode in common"):
        merge_modes([part(SETUPS[0], omega, shapes), part(SETUPS[1], 3 * omega, shapes)])


def ambient_setups(seed, levels=(1.0, 1.0), duration=600.0):
    """Two set-ups of the chain, one after another, under forces of different size."""
    made = []
    for number, (names, level) in enumerate(zip(SETUPS, levels, strict=True)):
        whole = ambient_chain(10 * seed + number, duration)
        rows = [int(name[0]) - 1 for name in names]
        made.append(TimeRecord(whole.sampling_rate, level * whole.values[:, rows], names, ("velocity",) * 3))
    return made


def test_merged_ambient_set_ups_give_the_modes_of_the_chain():
    omega, shapes = chain_modes()
    found = merge_modes([identify_modes(r, "ssi_cov", orders=[8], block_rows=12) for r in ambient_setups(1)])
    score = (found.omega - omega) / (2 * np.pi * np.sqrt(np.diag(found.covariance)[:4]))
    assert (np.abs(score) < 4).all()
    assert (np.diag(mac(found.mode_shapes, shapes[[0, 3, 1, 2]])) > 0.995).all()


def test_joint_modes_of_ambient_set_ups_are_those_of_the_chain_with_intervals_that_hold_them():
    omega, shapes = chain_modes()
    found = joint_modes(ambient_setups(1), options=OPTIONS).modes
    assert [str(dof) for dof in found.channels] == ["1X+", "4X+", "2X+", "3X+"]
    score = (found.omega - omega) / (2 * np.pi * np.sqrt(np.diag(found.covariance)[:4]))
    assert (np.abs(score) < 4).all()
    assert (np.diag(mac(found.mode_shapes, shapes[[0, 3, 1, 2]])) > 0.995).all()


def test_joint_modes_do_not_depend_on_the_level_of_excitation():
    even = joint_modes(ambient_setups(2), options=OPTIONS).modes
    uneven = joint_modes(ambient_setups(2, (1.0, 300.0)), options=OPTIONS).modes
    np.testing.assert_allclose(uneven.frequency, even.frequency, rtol=1e-9)
    np.testing.assert_allclose(uneven.mode_shapes, even.mode_shapes, atol=1e-8)
    np.testing.assert_allclose(uneven.covariance, even.covariance, rtol=1e-6, atol=1e-15)


def test_joint_modes_of_two_halves_of_one_record_with_all_sensors_are_those_of_the_whole():
    whole = ambient_chain(7)
    half = len(whole.values) // 2
    parts = [
        TimeRecord(whole.sampling_rate, y, whole.channels, whole.quantities)
        for y in (whole.values[:half], whole.values[half:])
    ]
    joint = joint_modes(parts, options=OPTIONS).modes
    single = identify_modes(parts, "ssi_cov", orders=[8], block_rows=12)
    std = np.sqrt(np.diag(single.covariance))[:4]
    assert (np.abs(joint.frequency - single.frequency) < 0.5 * std).all()  # weights of the halves differ
    np.testing.assert_allclose(np.sqrt(np.diag(joint.covariance))[:4], std, rtol=0.5)


def test_joint_deviations_are_differences_of_the_poles():
    """The analytic change of poles and shapes against a small step along one piece's deviation."""
    data = setup_data(ambient_setups(3), parse_dofs(["1X", "4X"]))
    space = joint_subspace(data, 10, 5)
    poles, shapes = joint_deviations(space, 8, range(4))
    factor, step = np.sqrt(5 / 4), 1e-6
    base = joint_poles(space, 8)
    for number, (setup, piece) in enumerate([(j, b) for j in range(2) for b in range(5)]):
        part = list(_parts(data, 10, setup, space.windows[setup]))[piece]
        split = _split(part, 10, 2)
        moved = []
        for sign in (1, -1):
            matrices = []
            for which, whole in enumerate((space.references, space.others)):
                own = list(whole)
                window = space.windows[setup][piece]
                own[setup] = own[setup] + sign * step * factor * (split[which] - window.part * own[setup])
                matrices.append(tuple(own))
            left, singular, right = np.linalg.svd(np.concatenate(matrices[0], axis=1), full_matrices=False)
            moved.append(joint_poles(JointSubspace(data, 10, *matrices, left, singular, right.T, space.windows), 8))
        difference = (moved[0].poles - moved[1].poles) / (2 * step)
        np.testing.assert_allclose(difference, poles[number], rtol=1e-5, atol=1e-6 * np.abs(poles).max())
        top = np.abs(base.shapes).argmax(axis=0), np.arange(4)
        unit = base.shapes / base.shapes[top]
        change = (moved[0].shapes / moved[0].shapes[top] - moved[1].shapes / moved[1].shapes[top]) / (2 * step)
        analytic = (shapes[number] - unit * shapes[number][top]) / base.shapes[top]
        np.testing.assert_allclose(change, analytic, rtol=1e-5, atol=1e-5 * np.abs(analytic).max())


def test_joint_modes_take_a_sensor_of_two_set_ups_from_the_first():
    setups = ambient_setups(4)
    third = ambient_chain(99)
    names = ("1X", "4X-", "2X")
    values = third.values[:, [0, 3, 1]] * [1.0, -1.0, 1.0]
    setups.append(TimeRecord(third.sampling_rate, values, names, ("velocity",) * 3))
    found = joint_modes(setups, options=OPTIONS).modes
    assert [str(dof) for dof in found.channels] == ["1X+", "4X+", "2X+", "3X+"]
    assert any("set-up 3: 2X+ is measured in an earlier set-up" in note for note in found.warnings)
    _, shapes = chain_modes()
    assert (np.diag(mac(found.mode_shapes, shapes[[0, 3, 1, 2]])) > 0.995).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a, b: [a], "two set-ups or more"),
        (lambda a, b: [a, replace(b, quantities=("acceleration",) * 3)], "one kind of motion"),
        (lambda a, b: [a, replace(b, sampling_rate=20.0)], "one rate"),
        (lambda a, b: [a, replace(b, values=b.values[:50])], "at least 72 samples"),
    ],
)
def test_joint_modes_name_what_does_not_fit(change, words):
    with pytest.raises(InputError, match=words):
        joint_modes(change(*ambient_setups(5, duration=60.0)), options=OPTIONS)
