"""A property as a smooth field: partition of unity, exact reproduction, names, and recovery from FRFs."""

import numpy as np
import pytest

from structid import (
    Field,
    FrfRecord,
    IdentifyOptions,
    InputError,
    Plate,
    Structure,
    Unknown,
    identify,
    parameters,
    simulated_record,
)
from structid.unknowns.unknown import field_functions


def plate(factor=1.0):
    """A cantilever plate of 6 by 3 elements whose modulus is 70 GPa times `factor` at x/length in each element."""
    x, y = np.linspace(0, 0.6, 7), np.linspace(0, 0.3, 4)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    corner = np.arange(24).reshape(6, 4)[:, :3].ravel()
    table = corner[:, None] + np.array([0, 4, 5, 1])
    middle = grid[table].mean(axis=1)
    young = 70e9 * (factor(middle) if callable(factor) else factor)
    held = [f"{node}{d}" for node in range(4) for d in ("Z", "RX", "RY")]
    skin = Plate("skin", table, young, 2700.0, 0.004, 0.3, loss_factor=0.02)
    return Structure(dict(enumerate(grid)), [skin], held), middle


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_functions_are_not_negative_and_sum_to_one(degree):
    middles = np.random.default_rng(1).uniform(-1, 2, (40, 3))
    values, places = field_functions(Field((3, 2, 1), degree), middles)
    assert values.shape[1] == len(places) <= np.prod(np.array([3, 2, 1]) + degree)
    assert values.min() >= 0
    assert values.sum(axis=1) == pytest.approx(np.ones(40), abs=1e-14)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_fields_hold_linear_variation_exactly(degree):
    middles = np.random.default_rng(2).uniform(0, 1, (60, 2))
    values, _ = field_functions(Field((3, 2), degree), middles)
    wanted = 1 + middles @ [0.5, -0.3]
    coefficients = np.linalg.lstsq(values.toarray(), wanted, rcond=None)[0]
    assert values @ coefficients == pytest.approx(wanted, abs=1e-12)


def test_functions_of_the_first_degree_are_hats():
    values, places = field_functions(Field((2,)), np.array([[0.0], [0.25], [0.5], [1.0]]))
    assert places == ("1", "2", "3")
    assert values.toarray() == pytest.approx(np.array([[1, 0, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 0, 1]]))


def test_functions_that_no_element_sees_and_flat_axes_are_left_out():
    _, places = field_functions(Field((4,)), np.array([[0.0], [0.05], [1.0]]))
    assert places == ("1", "2", "5")
    _, places = field_functions(Field((2, 2)), np.array([[0.0, 1.0], [1.0, 1.0]]))
    assert places == ("1", "3")
    with pytest.raises(InputError, match="the elements extend along Y too"):
        field_functions(Field((2,)), np.array([[0.0, 0.0], [1.0, 1.0]]))


def test_coefficients_of_one_leave_the_nominal_values():
    structure, _ = plate(lambda m: 1 + m[:, 0])
    unknown = parameters(structure, [Unknown("youngs_modulus", "skin", field=Field((2, 1)))])
    assert unknown.names[:2] == ("youngs_modulus[skin:field 1,1]", "youngs_modulus[skin:field 1,2]")
    assert (unknown.n_params, set(unknown.units)) == (6, {"1"})
    assert unknown.values(unknown.start) == pytest.approx(structure.values, rel=1e-14)
    fixed = parameters(structure, [Unknown("youngs_modulus", "skin", field=Field((2, 1)), start=0.5, fixed=True)])
    place = next(p.values for p in structure.properties if p.term.property == "youngs_modulus")
    assert fixed.offset[place] == pytest.approx(0.5 * structure.values[place], rel=1e-14)


def test_a_field_recovers_a_linear_stiffness_variation():
    truth, middle = plate(lambda m: 0.8 + 0.6 * m[:, 0])
    structure, _ = plate()
    like = FrfRecord(np.linspace(5, 150, 60), np.ones((60, 3, 1)), ["27Z", "19Z", "13Z"], ["27Z"], "accelerance")
    record = simulated_record(truth, parameters(truth, []), like, 0.002, np.random.default_rng(4))
    unknown = parameters(structure, [Unknown("youngs_modulus", "skin", field=Field((1, 1)))])
    found = identify(structure, unknown, record, IdentifyOptions(pole_free_start=False)).estimate
    values = unknown.values(found.values)
    place = next(p.values for p in structure.properties if p.term.property == "youngs_modulus")
    spread = unknown.design[place.start : place.stop] @ found.covariance @ unknown.design[place.start : place.stop].T
    error = values[place] - 70e9 * (0.8 + 0.6 * middle[:, 0])
    assert np.abs(error).max() <= 0.02 * 70e9
    assert (np.abs(error) <= 4 * np.sqrt(np.diag(spread))).all()


@pytest.mark.parametrize(
    "given, words",
    [
        ({"intervals": (0, 1)}, "`intervals` of a field must be 1 to 3 whole numbers of at least 1, got"),
        ({"intervals": (1,), "degree": 9}, "`degree` of a field must lie from 0 to 5, got 9"),
    ],
)
def test_bad_fields_are_told(given, words):
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        Field(**given)


def test_a_field_is_neither_each_nor_claimed_twice():
    structure, _ = plate()
    field = Field((1, 1))
    with pytest.raises(InputError, match="is a field of factors; leave `each`, `tied_to` and `factor` out of it"):
        parameters(structure, [Unknown("youngs_modulus", "skin", field=field, each=True)])
    with pytest.raises(InputError, match="claim the same value"):
        parameters(structure, [Unknown("youngs_modulus", "skin", field=field), Unknown("youngs_modulus", "skin:3")])
