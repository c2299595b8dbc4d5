"""Properties of beams and bars from a material and a cross-section, for the editor of structures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from structid.core.errors import InputError

#: Digits that a value keeps: more than any cross-section is made to.
_DIGITS = 6


@dataclass(frozen=True)
class Material:
    """Young's modulus and shear modulus in Pa, density in kg/m^3: handbook values."""

    youngs_modulus: float
    shear_modulus: float
    density: float


MATERIALS: dict[str, Material] = {
    "steel": Material(2.10e11, 8.1e10, 7850.0),
    "stainless steel": Material(2.00e11, 7.7e10, 7900.0),
    "aluminium": Material(7.0e10, 2.63e10, 2700.0),
    "concrete C30/37": Material(3.3e10, 1.375e10, 2500.0),
    "timber C24": Material(1.1e10, 6.9e8, 420.0),
}


@dataclass(frozen=True)
class CrossSection:
    """Area (m^2), second moments of area (m^4) and St Venant's torsion constant (m^4) of a cross-section.

    `strong` is that of bending in the plane of the height, `weak` that of bending across it.
    """

    area: float
    strong: float
    weak: float
    torsion: float


def rectangle(height: float, width: float) -> CrossSection:
    """Section properties of a solid rectangle of this `height` and `width`, m; torsion constant by Roark's formula to 0.5 %."""
    long, short = max(height, width), min(height, width)
    torsion = long * short**3 * (1 / 3 - 0.21 * short / long * (1 - short**4 / (12 * long**4)))
    return CrossSection(height * width, width * height**3 / 12, height * width**3 / 12, torsion)


def circle(diameter: float) -> CrossSection:
    """Section properties of a solid circle with `diameter` in m."""
    moment = math.pi * diameter**4 / 64
    return CrossSection(math.pi * diameter**2 / 4, moment, moment, 2 * moment)


def tube(diameter: float, wall: float) -> CrossSection:
    """Area (m^2), second moments and torsion constant (m^4) of a round tube with outer `diameter` and `wall` in m.

    Raises
    ------
    InputError
        If the wall is thicker than half the diameter.
    """
    inner = diameter - 2 * wall
    if inner < 0:
        raise InputError(f"the wall must be at most half the diameter of {diameter:g} m, got {wall:g} m")
    moment = math.pi * (diameter**4 - inner**4) / 64
    return CrossSection(math.pi * (diameter**2 - inner**2) / 4, moment, moment, 2 * moment)


def box(height: float, width: float, wall: float) -> CrossSection:
    """Area (m^2), second moments and torsion constant (m^4) of a thin rectangular tube with sharp corners.

    Outer `height` and `width` and `wall` thickness are in m. The torsion constant is that of Bredt's formula.

    Raises
    ------
    InputError
        If the walls leave no hollow.
    """
    if 2 * wall >= min(height, width):
        raise InputError(f"the wall must be less than half of {min(height, width):g} m, got {wall:g} m")
    outer, inner = rectangle(height, width), rectangle(height - 2 * wall, width - 2 * wall)
    mid = (height - wall) * (width - wall)
    torsion = 2 * mid**2 * wall / (height + width - 2 * wall)
    return CrossSection(outer.area - inner.area, outer.strong - inner.strong, outer.weak - inner.weak, torsion)


def rolled_i(height: float, width: float, web: float, flange: float, fillet: float) -> CrossSection:
    """Area (m^2), second moments and torsion constant (m^4) of a rolled I or H profile with round fillets.

    Flanges are parallel; `web` and `flange` are thicknesses, `fillet` is the radius, `height` and `width` are the outer
    sides, all in m.
    """
    corner = (1 - math.pi / 4) * fillet**2
    offset = fillet * (10 - 3 * math.pi) / (12 - 3 * math.pi)  # of its centroid from the corner
    own = fillet**4 * (1 / 3 - math.pi / 16 - 1 / (9 * (4 - math.pi)))
    clear = height - 2 * flange
    strong = (width * height**3 - (width - web) * clear**3) / 12
    strong += 4 * (corner * (clear / 2 - offset) ** 2 + own)
    weak = (2 * flange * width**3 + clear * web**3) / 12 + 4 * (corner * (web / 2 + offset) ** 2 + own)
    joint = ((fillet + web / 2) ** 2 + (fillet + flange) ** 2 - fillet**2) / (2 * fillet + flange)
    torsion = 2 / 3 * (width - 0.63 * flange) * flange**3 + clear * web**3 / 3
    torsion += 2 * web / flange * (0.145 + 0.1 * fillet / flange) * joint**4
    return CrossSection(2 * width * flange + clear * web + 4 * corner, strong, weak, torsion)


class Shape(NamedTuple):
    """A shape of cross-section: its function of sizes in m, and the sizes that it asks for, mm, as they are to begin with."""

    section: Callable[..., CrossSection]
    sizes: dict[str, float]


SHAPES: dict[str, Shape] = {
    "rectangle": Shape(rectangle, {"height": 20.0, "width": 10.0}),
    "round bar": Shape(circle, {"diameter": 20.0}),
    "round tube": Shape(tube, {"diameter": 60.3, "wall": 3.2}),
    "rectangular tube": Shape(box, {"height": 100.0, "width": 50.0, "wall": 4.0}),
}

#: Height, width, web, flange and fillet of rolled profiles, mm (EN 10365).
PROFILES: dict[str, tuple[float, float, float, float, float]] = {
    "IPE 80": (80, 46, 3.8, 5.2, 5), "IPE 100": (100, 55, 4.1, 5.7, 7), "IPE 120": (120, 64, 4.4, 6.3, 7),
    "IPE 140": (140, 73, 4.7, 6.9, 7), "IPE 160": (160, 82, 5.0, 7.4, 9), "IPE 180": (180, 91, 5.3, 8.0, 9),
    "IPE 200": (200, 100, 5.6, 8.5, 12), "IPE 220": (220, 110, 5.9, 9.2, 12), "IPE 240": (240, 120, 6.2, 9.8, 15),
    "IPE 270": (270, 135, 6.6, 10.2, 15), "IPE 300": (300, 150, 7.1, 10.7, 15), "IPE 330": (330, 160, 7.5, 11.5, 18),
    "IPE 360": (360, 170, 8.0, 12.7, 18), "IPE 400": (400, 180, 8.6, 13.5, 21), "IPE 450": (450, 190, 9.4, 14.6, 21),
    "IPE 500": (500, 200, 10.2, 16.0, 21), "IPE 550": (550, 210, 11.1, 17.2, 24), "IPE 600": (600, 220, 12.0, 19.0, 24),
    "HEA 100": (96, 100, 5.0, 8.0, 12), "HEA 120": (114, 120, 5.0, 8.0, 12), "HEA 140": (133, 140, 5.5, 8.5, 12),
    "HEA 160": (152, 160, 6.0, 9.0, 15), "HEA 180": (171, 180, 6.0, 9.5, 15), "HEA 200": (190, 200, 6.5, 10.0, 18),
    "HEA 220": (210, 220, 7.0, 11.0, 18), "HEA 240": (230, 240, 7.5, 12.0, 21), "HEA 260": (250, 260, 7.5, 12.5, 24),
    "HEA 280": (270, 280, 8.0, 13.0, 24), "HEA 300": (290, 300, 8.5, 14.0, 27), "HEB 100": (100, 100, 6.0, 10.0, 12),
    "HEB 120": (120, 120, 6.5, 11.0, 12), "HEB 140": (140, 140, 7.0, 12.0, 12), "HEB 160": (160, 160, 8.0, 13.0, 15),
    "HEB 180": (180, 180, 8.5, 14.0, 15), "HEB 200": (200, 200, 9.0, 15.0, 18), "HEB 220": (220, 220, 9.5, 16.0, 18),
    "HEB 240": (240, 240, 10.0, 17.0, 21), "HEB 260": (260, 260, 10.0, 17.5, 24), "HEB 280": (280, 280, 10.5, 18.0, 24),
    "HEB 300": (300, 300, 11.0, 19.0, 27),
}  # fmt: skip


def presets() -> dict[str, Any]:
    """Names of ``materials`` that the page offers, and ``shapes``: solid and hollow ones, then rolled profiles.

    A shape is a mapping with ``name`` and ``sizes`` (mm by name) to begin with, empty for a profile.
    """
    shapes = {**{name: shape.sizes for name, shape in SHAPES.items()}, **{name: {} for name in PROFILES}}
    return {"materials": list(MATERIALS), "shapes": [{"name": name, "sizes": sizes} for name, sizes in shapes.items()]}


def cross_section(shape: str, sizes: Mapping[str, float]) -> CrossSection:
    """Area (m^2), second moments of area and torsion constant (m^4) of the cross-section called `shape`.

    It is a key of `SHAPES` or `PROFILES`. `sizes` are the dimensions of a shape by name, in mm; they are ignored for
    rolled profiles.

    Raises
    ------
    InputError
        If there is no such shape, or a size is missing or not positive.
    """
    if shape in PROFILES:
        return rolled_i(*(size / 1000 for size in PROFILES[shape]))
    if shape not in SHAPES:
        raise InputError(f"there is no shape {shape!r}; choose among {', '.join([*SHAPES, *PROFILES])}")
    values = {}
    for name in SHAPES[shape].sizes:
        try:
            values[name] = float(sizes[name]) / 1000
        except (KeyError, TypeError, ValueError):
            raise InputError(f"the {name} of the {shape} must be a number in mm, got {sizes.get(name)!r}") from None
        if not 0 < values[name] < math.inf:
            raise InputError(f"the {name} of the {shape} must be greater than 0 mm, got {sizes[name]}")
    return SHAPES[shape].section(**values)


def element_properties(
    element: str, material: str, shape: str, sizes: Mapping[str, float], is_turned: bool = False
) -> dict[str, float]:
    """Properties of a beam element by name, in SI units, from material and cross-section, rounded to six digits.

    `element` is "beam", "bar" or "space_beam"; `sizes` are in mm, see `cross_section`. The height of the section lies in the
    plane of a beam, or along local y of a space beam; with `is_turned` the width does.

    Raises
    ------
    InputError
        If there is no such material, shape or element, or a size cannot be used.
    """
    if material not in MATERIALS:
        raise InputError(f"there is no material {material!r}; choose among {', '.join(MATERIALS)}")
    of, section = MATERIALS[material], cross_section(shape, sizes)
    strong, weak = (section.weak, section.strong) if is_turned else (section.strong, section.weak)
    properties = {"mass": of.density * section.area}
    axial = of.youngs_modulus * section.area
    if element == "bar":
        properties["axial_stiffness"] = axial
    elif element == "beam":
        properties |= {"bending_stiffness": of.youngs_modulus * strong, "axial_stiffness": axial}
    elif element == "space_beam":
        properties |= {
            "bending_stiffness_y": of.youngs_modulus * weak,
            "bending_stiffness_z": of.youngs_modulus * strong,
            "axial_stiffness": axial,
            "torsional_stiffness": of.shear_modulus * section.torsion,
            "polar_inertia": of.density * (section.strong + section.weak),
        }
    else:
        raise InputError(f"there are no sections of {element!r}; choose beam, bar or space_beam")
    return {name: float(f"{value:.{_DIGITS}g}") for name, value in properties.items()}
