"""Medians and maxima of the lines about each line, against the filters of SciPy."""

import numpy as np
import pytest
from scipy import ndimage

from structid.diagnose import data_rows


@pytest.mark.parametrize("n_lines", [1, 5, 20, 21, 300])
def test_lines_about_each_line_are_those_of_a_filter(n_lines):
    size = np.random.default_rng(n_lines).standard_exponential(n_lines) ** 3
    level = np.maximum(ndimage.median_filter(size, data_rows.LINES_ABOUT, mode="nearest"), 1.0)
    assert np.array_equal(data_rows._level_about(size), level)
    width = 2 * data_rows.TONE_SKIRT + 1
    assert np.array_equal(data_rows._neighbours(size, width).max(axis=1), ndimage.maximum_filter(size, width))
