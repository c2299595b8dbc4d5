"""Properties from material and cross-section, against printed tables of profiles and integrals over the shape."""

from __future__ import annotations

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.workbench.sections import MATERIALS, PROFILES, cross_section, element_properties

# A cm^2, Iy cm^4, Iz cm^4, It cm^4 as EN 10365 tables print them
PRINTED = {
    "IPE 100": (10.32, 171.0, 15.92, 1.20),
    "IPE 200": (28.48, 1943.0, 142.4, 6.98),
    "IPE 300": (53.81, 8356.0, 603.8, 20.12),
    "HEA 200": (53.83, 3692.0, 1336.0, 20.98),
    "HEB 200": (78.08, 5696.0, 2003.0, 59.28),
}


@pytest.mark.parametrize("name", PRINTED)
def test_a_rolled_profile_has_its_printed_values(name):
    section = cross_section(name, {})
    area, strong, weak, torsion = PRINTED[name]
    assert section.area * 1e4 == pytest.approx(area, rel=2e-3)
    assert section.strong * 1e8 == pytest.approx(strong, rel=2e-3)
    assert section.weak * 1e8 == pytest.approx(weak, rel=2e-3)
    assert section.torsion * 1e8 == pytest.approx(torsion, rel=1e-2)


@pytest.mark.parametrize(
    ("shape", "sizes", "inside"),
    [
        ("rectangle", {"height": 30, "width": 20}, lambda y, z: (abs(y) < 15) & (abs(z) < 10)),
        ("round bar", {"diameter": 30}, lambda y, z: y**2 + z**2 < 15**2),
        ("round tube", {"diameter": 30, "wall": 5}, lambda y, z: (y**2 + z**2 < 15**2) & (y**2 + z**2 > 10**2)),
        (
            "rectangular tube",
            {"height": 30, "width": 20, "wall": 4},
            lambda y, z: (abs(y) < 15) & (abs(z) < 10) & ((abs(y) > 11) | (abs(z) > 6)),
        ),
    ],
)
def test_area_and_moments_are_integrals_over_the_shape(shape, sizes, inside):
    side = (np.arange(1600) + 0.5) / 50 - 16.0  # mm
    y, z = np.meshgrid(side, side)
    part = inside(y, z) * 0.02**2
    section = cross_section(shape, sizes)
    assert section.area * 1e6 == pytest.approx(part.sum(), rel=1e-3)
    assert section.strong * 1e12 == pytest.approx((part * y**2).sum(), rel=1e-3)
    assert section.weak * 1e12 == pytest.approx((part * z**2).sum(), rel=1e-3)


def test_torsion_of_a_square_and_of_a_strip_and_of_a_closed_tube():
    assert cross_section("rectangle", {"height": 10, "width": 10}).torsion == pytest.approx(0.1406e-8, rel=5e-3)
    assert cross_section("rectangle", {"height": 1000, "width": 1}).torsion == pytest.approx(1e-9 / 3, rel=1e-3)
    tube = cross_section("rectangular tube", {"height": 100, "width": 100, "wall": 2})
    assert tube.torsion == pytest.approx(0.098**3 * 0.002, rel=1e-9)  # Bredt, square: a^3 t


def test_properties_are_those_of_material_and_section_in_units_of_the_study():
    beam = element_properties("beam", "steel", "IPE 200", {})
    assert beam["mass"] == pytest.approx(22.4, rel=5e-3)  # kg/m, printed
    assert beam["bending_stiffness"] == pytest.approx(2.1e11 * 1943e-8, rel=2e-3)
    assert beam["axial_stiffness"] == pytest.approx(2.1e11 * 28.48e-4, rel=2e-3)
    turned = element_properties("beam", "steel", "IPE 200", {}, is_turned=True)
    assert turned["bending_stiffness"] == pytest.approx(2.1e11 * 142.4e-8, rel=2e-3)
    space = element_properties("space_beam", "aluminium", "rectangle", {"height": 30, "width": 10})
    assert space["bending_stiffness_z"] == pytest.approx(9 * space["bending_stiffness_y"])
    assert space["polar_inertia"] == pytest.approx(2700 * (10 * 30**3 + 30 * 10**3) / 12 * 1e-12, rel=1e-5)
    assert set(element_properties("bar", "timber C24", "round bar", {"diameter": 20})) == {"mass", "axial_stiffness"}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("beam", "gold", "IPE 200", {}), "no material 'gold'"),
        (("beam", "steel", "IPE 205", {}), "no shape 'IPE 205'"),
        (("beam", "steel", "round bar", {"diameter": "0"}), "must be greater than 0 mm"),
        (("beam", "steel", "round bar", {"diameter": "thick"}), "must be a number in mm"),
        (("beam", "steel", "round bar", {}), "must be a number in mm"),
        (("beam", "steel", "round tube", {"diameter": 20, "wall": 11}), "at most half the diameter"),
        (("beam", "steel", "rectangular tube", {"height": 20, "width": 8, "wall": 4}), "less than half"),
        (("plate", "steel", "IPE 200", {}), "no sections of 'plate'"),
    ],
)
def test_what_cannot_be_is_told(given, words):
    with pytest.raises(InputError, match=words):
        element_properties(*given)


def test_materials_and_profiles_are_in_plausible_units():
    assert all(1e9 < one.youngs_modulus < 3e11 and 300 < one.density < 9000 for one in MATERIALS.values())
    assert all(one.shear_modulus < one.youngs_modulus / 2 for one in MATERIALS.values())
    assert all(max(sizes) <= 600 and min(sizes) > 3 for sizes in PROFILES.values())
