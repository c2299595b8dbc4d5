"""Modes of several set-ups merged: exactness, weights, agreement, and what is lost."""

from dataclasses import replace

import numpy as np
import pytest
from modal_cases import ambient_chain, chain_modes

from structid import InputError, ModalRecord
from structid.modal.identification import identify_modes
from structid.modal.merging import merge_modes, merged_setups, merged_shape
from structid.records import TimeRecord
from structid.similarity import mac

SETUPS = (("1X", "4X", "2X"), ("1X", "4X", "3X"))


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
    sure, unsure = part(SETUPS[0], f, shapes, std=0.01), part(SETUPS[1], f + 0.02, shapes, std=0.02)
    found = merged_setups([sure, unsure])
    np.testing.assert_allclose(found.modes.frequency, f + 0.02 * 0.2)
    np.testing.assert_allclose(found.frequency_spread, 0.02 / np.sqrt(2))
    chi_square = 0.02**2 / (0.01**2 + 0.02**2)
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
    unsure = (12.7062 / 1.95996) ** 2  # 97.5 % points of Student's t with one degree of freedom, and of the normal law
    np.testing.assert_allclose(variance[2], 0.5e-4 * (1 + unsure * (found.chi_square[2] - 1)), rtol=1e-4)
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
    assert found.warnings[0].startswith("merging leaves out 1 of 7 modes, of 1 of 2 set-ups, since no other set-up has")
    assert f"set-up 1: {omega[2]:.4g} Hz (none in set-up 2, nearest" in found.warnings[0]


def test_merging_keeps_a_mode_that_two_of_three_set_ups_have_and_leaves_unmeasured_sensors_unknown():
    """Mode 3 is missing in the set-up that alone has sensor 3X: unknown there, right at the others."""
    omega, shapes = chain_modes()
    few = [0, 1, 3]
    lacking = part(("1X", "4X", "3X"), omega[few], shapes[:, few])
    whole = [part(("1X", "4X", "2X"), omega, shapes, scale=scale) for scale in (1.0, -2j)]
    for setups in ([lacking, *whole], [*whole, lacking], [whole[0], lacking, whole[1]]):
        merging = merged_setups(setups)
        place = [str(dof) for dof in merging.modes.channels].index("3X+")
        assert (~merging.modes.known).nonzero() == ([place], [2])
        assert np.isnan(merging.modes.shape_std).nonzero() == ([place], [2])
        assert (merging.members == -1).sum() == 1
        assert merging.members[setups.index(lacking), 2] == -1
        np.testing.assert_allclose(merging.modes.frequency, omega)
        known = [i for i in range(4) if i != place]
        order = [int(str(merging.modes.channels[i])[0]) - 1 for i in known]
        likeness = np.diag(mac(merging.modes.mode_shapes[known], shapes[order]))
        np.testing.assert_allclose(likeness, 1.0, atol=1e-12)
        variance = np.diag(merging.modes.covariance)[:4]
        np.testing.assert_allclose(variance, np.array([1, 1, 1.5, 1]) * 1e-6 / 3)


def test_scatter_between_set_ups_is_a_random_effect():
    """Four set-ups of unequal deviations: the moment estimate of DerSimonian and Laird (1986), here by hand."""
    _, shapes = chain_modes()
    f, stds, moves = np.array([1.0, 2.0, 3.0, 4.0]), [0.01, 0.02, 0.01, 0.04], [0.0, 0.05, -0.03, 0.02]
    setups = [part(SETUPS[i % 2], f + move, shapes, std=s) for i, (s, move) in enumerate(zip(stds, moves, strict=True))]
    w, y = 1 / np.square(stds), np.array(moves)
    q = np.sum(w * (y - w @ y / w.sum()) ** 2)
    scatter = (q - 3) / (w.sum() - np.sum(w**2) / w.sum())
    w = 1 / (np.square(stds) + scatter)
    merging = merged_setups(setups)
    np.testing.assert_allclose(merging.scatter[:4], np.sqrt(scatter))
    np.testing.assert_allclose(merging.modes.frequency, f + w @ y / w.sum())
    unsure = (3.18245 / 1.95996) ** 2  # Student's t with three degrees of freedom
    squares = (w / w.sum()) ** 2
    expected = np.sqrt(squares @ np.square(stds) + unsure * squares.sum() * scatter)
    np.testing.assert_allclose(merging.modes.frequency_std, expected, rtol=1e-4)
    np.testing.assert_allclose(merging.scatter[4:], 0.0)


def without(record, *entries):
    shapes = np.array(record.mode_shapes)
    for entry in entries:
        shapes[entry] = np.nan
    return replace(record, mode_shapes=shapes)


def test_merging_leaves_entries_that_a_set_up_does_not_know_to_the_others():
    """One reference and one own place of a mode unknown in one set-up; the place then is unknown in the merged shape."""
    omega, shapes = chain_modes()
    first, second = part(SETUPS[0], omega, shapes, scale=2 + 1j), part(("4X-", "3X", "1X"), omega, shapes, scale=-0.3)
    found = merge_modes([without(first, (1, 0)), without(second, (1, 2))])
    order = [0, 3, 1, 2]
    assert (~found.known).nonzero() == ([3], [2])
    for m in range(4):
        known = found.known[:, m]
        np.testing.assert_allclose(mac(found.mode_shapes[known, m], shapes[order, m][known]).item(), 1.0, atol=1e-12)
        np.testing.assert_allclose(np.nanmax(np.abs(found.mode_shapes[:, m])), 1.0)
    assert (np.isnan(found.shape_std) == ~found.known).all()
    whole = merge_modes([first, second])
    np.testing.assert_allclose(found.shape_std[:, [1, 3]], whole.shape_std[:, [1, 3]])
    lost = merge_modes([without(first, (0, 1), (1, 1)), second])
    assert lost.n_modes == 3
    assert f"set-up 1: {omega[1]:.4g} Hz (none of its references is known);" in lost.warnings[0]
    assert f"set-up 2: {omega[1]:.4g} Hz (none in set-up 1, nearest" in lost.warnings[0]


def test_merging_without_covariance_gives_none():
    omega, shapes = chain_modes()
    found = merged_setups([part(names, omega, shapes, None, None) for names in SETUPS])
    assert found.modes.covariance is None
    assert found.modes.shape_std is None
    assert np.isnan(found.probability).all()


def test_merging_keeps_the_deviations_that_are_known_and_says_what_is_lost():
    """A damping ratio without a deviation, none of one mode at all, and a set-up as of UFF, without any."""
    omega, shapes = chain_modes()
    first, second = (part(names, omega, shapes) for names in SETUPS)
    covariance = np.array(second.covariance)
    covariance[6, :] = covariance[:, 6] = np.nan
    damping = np.array(second.damping_ratio)
    damping[1], damping[2] = np.nan, 0.5
    found = merge_modes([first, replace(second, damping_ratio=damping, covariance=covariance)])
    np.testing.assert_allclose(
        found.std, [*np.full(4, 1e-3 / np.sqrt(2)), 1e-3 / np.sqrt(2), 1e-3, 1e-3, 1e-3 / np.sqrt(2)]
    )
    np.testing.assert_allclose(found.damping_ratio, 0.01)
    (note,) = found.warnings
    assert note == (
        f"set-up 2 states no deviations of the damping ratios of {omega[2]:.4g} Hz: these have no part in the means, which are"
        " of the others"
    )
    bare = part(SETUPS[1], omega + 0.1, shapes, None, None)
    merged = merged_setups([first, bare])
    np.testing.assert_allclose(merged.modes.frequency, omega)
    np.testing.assert_allclose(merged.modes.std, 1e-3)
    assert np.isnan(merged.chi_square).all()
    assert (np.nan_to_num(merged.modes.shape_std) > 0).sum(axis=0).tolist() == [3, 3, 3, 3]  # 0 at the largest
    larger = merge_modes([first, replace(bare, mode_shapes=30 * bare.mode_shapes)])
    clear = [0, 2, 3]  # mode 2 has two largest entries
    np.testing.assert_allclose(larger.shape_std[:, clear], merged.modes.shape_std[:, clear], rtol=1e-6)
    words = " ".join(merged.modes.warnings)
    assert "set-up 2 states no deviations of the frequencies of its modes: these have no part" in words
    assert "set-up 2 states no deviations of the damping ratios of its modes" in words
    assert "set-up 2 states no deviations of shape entries of its modes: they are taken to have the middle one" in words


def test_merging_without_damping_keeps_the_deviations_of_frequencies():
    omega, shapes = chain_modes()
    covariance = np.diag([*np.full(4, 1e-6), *np.full(4, np.nan)])
    setups = [replace(part(n, omega, shapes), damping_ratio=np.full(4, np.nan), covariance=covariance) for n in SETUPS]
    found = merge_modes(setups)
    np.testing.assert_allclose(found.frequency_std, 1e-3 / np.sqrt(2))
    assert np.isnan(found.damping_ratio).all()
    assert not found.warnings


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
        ([("1X", "2X")], None, "two set-ups or more are merged, got set-up 1;"),
        (
            [("1X", "2X"), ("3X", "4X")],
            None,
            r"none is in all of them: set-up 1 has 1X\+, 2X\+; set-up 2 has 3X\+, 4X\+;",
        ),
        ([("1X", "2X"), ("1X", "3X"), ("1X", "2X")], None, "set-up 1 and set-up 3 hold the same modes"),
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
