"""Standard deviations of shapes, freed from their scaling."""

import numpy as np

from structid.modal.modal_record import unscaled_shape_std


def test_unscaled_shape_std_gives_back_the_errors_before_scaling():
    """Equal errors of 0.01 in every entry, scaled by an entry that has the same error."""
    rng = np.random.default_rng(0)
    truth = np.array([1.0, 0.8, -0.3, 0.05])
    drawn = truth + 0.01 * rng.standard_normal((4000, 4))
    std = (drawn / drawn[:, :1]).std(axis=0)
    assert std[0] == 0.0
    freed = unscaled_shape_std(truth[:, None], std[:, None])
    np.testing.assert_allclose(freed[:, 0], 0.01, rtol=0.05)  # 4000 draws: 1.1 % standard error
    assert std[1] > 1.2 * 0.01  # what the scaling had added


def test_unscaled_shape_std_takes_rounding_for_zero():
    shapes, std = np.array([[1.0], [0.5]]), np.array([[1e-19], [0.02]])
    np.testing.assert_allclose(unscaled_shape_std(shapes, std), 0.02 / np.sqrt(1.25))


def test_unscaled_shape_std_leaves_others_as_they_are():
    std = np.array([[0.01, 0.0], [0.02, 0.0]])
    np.testing.assert_array_equal(unscaled_shape_std(np.ones((2, 2)), std), std)


def test_unscaled_shape_std_passes_over_unknown_entries():
    shapes, std = np.array([[1.0], [np.nan], [0.5]]), np.array([[0.0], [np.nan], [0.02]])
    np.testing.assert_allclose(
        unscaled_shape_std(shapes, std), [[0.02 / np.sqrt(1.25)], [np.nan], [0.02 / np.sqrt(1.25)]]
    )
