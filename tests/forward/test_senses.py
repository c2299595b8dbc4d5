"""Loads, sensors and contacts that share columns are read with their own sense and size."""

import numpy as np
from scipy import sparse

from structid.forward.frf.line_equations import channels


def test_fields_under_shared_columns_are_those_under_each_load_sensor_and_contact():
    """Columns that differ by their sign are one; fields (any linear map of columns) must come back with it."""
    rng = np.random.default_rng(0)
    first, second, third = np.eye(5)[:3]
    loads = np.stack([-first, second], axis=1)
    sensors = np.stack([first, -second, third - first], axis=1)
    contacts = (first - third)[:, None]
    made = channels(*(sparse.csc_array(one) for one in (loads, sensors, contacts)))
    assert made.columns.shape[1] == 3
    solve = rng.standard_normal((4, 5, 5))
    fields = solve @ made.columns.toarray()
    np.testing.assert_allclose(made.under_loads(fields), solve @ loads, rtol=0, atol=1e-14)
    both = np.concatenate([sensors, contacts], axis=1)
    np.testing.assert_allclose(made.under_sensors(fields), solve @ both, rtol=0, atol=1e-14)
    np.testing.assert_allclose(made.read(fields), both.T @ fields, rtol=0, atol=1e-14)
