"""A deviation of a prior is in the unit of its parameter, or a part of the mean."""

import numpy as np
import pytest

from structid.study.schema.study import load_study
from study_cases import replaced, write_chain


@pytest.mark.parametrize("stated", ["std = 56.25", "relative_std = 0.0625"])
def test_a_deviation_is_stated_in_the_unit_or_as_a_part_of_the_mean(tmp_path, stated):
    text = replaced("each = true", f"prior = {{mean = 900.0, {stated}}}")
    priors = load_study(write_chain(tmp_path, text)).parameters.priors
    assert priors.std[np.isfinite(priors.std)].tolist() == [56.25]
