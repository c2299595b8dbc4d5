"""Parameters: names, the map to property values, transforms, ties and refusals."""

import numpy as np
import pytest

from structid import Beam, InputError, PointMass, Prior, SpaceBeam, Structure, Unknown, parameters
from structid.unknowns import Transforms

BEAM = Beam("beam", [[0, 1], [1, 2], [2, 3]], [1.0, 2.0, 3.0], 5.0, loss_factor=0.01)
STRUCTURE = Structure({i: float(i) for i in range(4)}, [BEAM, PointMass("tip", [3], 4.0)], ["0Y", "0RZ"])


def values_of(structure, made, label, physical):
    item = next(p for p in structure.properties if p.label == label)
    return made.values(np.asarray(physical, float))[item.values]


def test_each_gives_one_absolute_parameter_an_element():
    made = parameters(STRUCTURE, [Unknown("mass", "beam", each=True)])
    assert made.names == ("mass[beam:1]", "mass[beam:2]", "mass[beam:3]")
    assert made.units == ("kg/m",) * 3
    assert made.start == pytest.approx([1.0, 2.0, 3.0])
    assert values_of(STRUCTURE, made, "mass[beam]", [7, 8, 9]) == pytest.approx([7, 8, 9])
    assert values_of(STRUCTURE, made, "mass[tip]", [7, 8, 9]) == pytest.approx([4.0])


def test_a_group_of_unequal_values_gets_a_factor_and_of_equal_ones_a_value():
    made = parameters(STRUCTURE, [Unknown("mass", "beam:1-2"), Unknown("stiffness", "beam", name="all")])
    assert made.names == ("mass[beam:1-2]", "stiffness[all]")
    assert made.units == ("1", "N m^2")
    assert values_of(STRUCTURE, made, "mass[beam]", [2.0, 9.0]) == pytest.approx([2.0, 4.0, 3.0])
    assert values_of(STRUCTURE, made, "bending_stiffness[beam]", [2.0, 9.0]) == pytest.approx([9.0] * 3)


def test_stiffness_of_an_element_with_several_is_a_common_factor():
    structure = Structure({1: (0, 0, 0), 2: (0, 0, 1)}, [SpaceBeam("c", [1, 2], 1.0, 2.0, 3.0, 4.0)])
    made = parameters(structure, [Unknown("stiffness", "c")])
    assert made.units == ("1",)
    assert values_of(structure, made, "bending_stiffness_z[c]", [1.5]) == pytest.approx([4.5])
    assert values_of(structure, made, "axial_stiffness[c]", [1.5]) == pytest.approx([6.0])


def test_ties_and_fixed_parameters():
    made = parameters(
        STRUCTURE,
        [
            Unknown("mass", "tip"),
            Unknown("mass", "beam:1", tied_to="mass[tip]", ratio=0.5),
            Unknown("mass", "beam:2", tied_to="mass[beam:1]", ratio=0.1),
            Unknown("mass", "beam:3", start=6.0, fixed=True),
        ],
    )
    assert made.names == ("mass[tip]",)
    assert values_of(STRUCTURE, made, "mass[beam]", [8.0]) == pytest.approx([4.0, 0.4, 6.0])


def test_parameters_kept_near_their_start_keep_their_own_priors():
    unknowns = [Unknown("mass", "tip", prior=Prior(3.0, 0.1)), Unknown("loss_factor", "beam")]
    near = parameters(STRUCTURE, unknowns).kept_near_start(0.3)
    assert near.priors.mean == pytest.approx([3.0, 0.01])
    assert near.priors.std == pytest.approx([0.1, 0.003])
    at_zero = parameters(STRUCTURE, [Unknown("mass_damping", "beam", positive=False)]).kept_near_start(0.3)
    assert not at_zero.priors.stated.any()


@pytest.mark.parametrize("kind", ["log", "linear", "interval"])
def test_transforms_invert_and_their_slope_is_the_derivative(kind):
    t = Transforms((kind,), np.array([0.5]), np.array([3.0]))
    theta = t.free(np.array([1.3]))
    assert t.physical(theta) == pytest.approx([1.3], rel=1e-14)
    step = 1e-6
    difference = (t.physical(theta + step) - t.physical(theta - step)) / (2 * step)
    assert t.slope(theta) == pytest.approx(difference, rel=1e-9)
    extreme = t.physical(np.array([40.0]))
    assert kind != "interval" or extreme[0] <= 3.0


@pytest.mark.parametrize(
    ("unknowns", "fragment"),
    [
        ([Unknown("mass", "beem")], "nearest is 'beam'"),
        ([Unknown("massive", "beam")], "no property 'massive'; it has mass"),
        ([Unknown("mass", "beam:4")], "1 to 3"),
        ([Unknown("mass", "beam"), Unknown("mass", "beam:2")], "claim the same value"),
        ([Unknown("mass", "beam:1"), Unknown("mass", "beam:2", name="beam:1")], "two parameters are called"),
        ([Unknown("mass", "tip", start=-1.0)], r"initial value of mass\[tip\] must lie between 0"),
        ([Unknown("mass", "tip", bounds=(5.0, 6.0))], "between 5 and 6, got 4"),
        ([Unknown("mass", "tip", bounds=(6.0, 5.0))], "must increase"),
        ([Unknown("mass", "tip", prior=Prior(1.0, 0.0))], "positive std"),
        ([Unknown("mass", "tip", tied_to="mas[tip]")], "which is no parameter"),
        ([Unknown("mass", "tip", tied_to="mass[beam:1]"), Unknown("mass", "beam:1", tied_to="mass[tip]")], "circle"),
        ([Unknown("stiffness_damping", "beam")], r"initial value of stiffness_damping\[beam\]"),
        ([Unknown("stiffness_damping", "beam", factor=True)], "all 0"),
    ],
)
def test_bad_declarations_are_refused_with_the_nearest_valid_one(unknowns, fragment):
    with pytest.raises(InputError, match=fragment):
        parameters(STRUCTURE, unknowns)
