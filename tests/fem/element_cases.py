"""Sample sets of every element type, and the laws that each of them keeps."""

from __future__ import annotations

import inspect
import pickle
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
from cells_cases import box

from structid import (
    Bar,
    Beam,
    Dashpot,
    Friction,
    InputError,
    Joint,
    Membrane,
    Plane,
    Plate,
    PointMass,
    RotaryInertia,
    Shell,
    Solid,
    SpaceBeam,
    Spring,
    Structure,
)
from structid.core.dof import Dof
from structid.fem import ELEMENT_TYPES
from structid.fem.elements import ElementSet
from structid.fem.elements.element import declarations
from structid.study.schema.model.structure import element_table, read_structure
from structid.study.schema.section import InputFiles, Section, StudyText

RNG = np.random.default_rng(20261121)
LINE = {1: 0.0, 2: 0.7, 3: 2.0}
PLANE = {label: RNG.standard_normal(2) for label in (1, 2, 3)}
SPACE = {label: RNG.standard_normal(3) for label in (1, 2, 3)}
PAIRS = [[1, 2], [2, 3]]


@dataclass(frozen=True, eq=False)
class Case:
    """Nodes and one element set on them; `mass` is what moves in any translation, and `turns` whether it turns freely.

    `beside` are sets that it cannot be without.
    """

    name: str
    nodes: dict
    element: ElementSet
    mass: float = 0.0
    turns: bool = True
    beside: tuple = ()

    @property
    def structure(self) -> Structure:
        return self.made(self.element)

    def made(self, element: ElementSet) -> Structure:
        order = list(ELEMENT_TYPES.values())  # as a study file has them
        return Structure(self.nodes, sorted([*self.beside, element], key=lambda one: order.index(type(one))))


def lengths(nodes: dict) -> np.ndarray:
    return np.array([np.linalg.norm(np.subtract(nodes[b], nodes[a])) for a, b in PAIRS])


def on_cells(name, kind, made, mass, shape=(2, 1), size=(1.0, 0.6), rise=None) -> Case:
    """Cells of one kind on a distorted box; `made` takes the node table, `rise` lifts the nodes out of the plane."""
    points, table = box(kind, shape, size, jitter=0.1)
    if rise is not None:
        points = np.column_stack([points, rise(points)])
    return Case(name, {i + 1: p for i, p in enumerate(points)}, made(table + 1), mass)


ELASTIC = {"youngs_modulus": 70e9, "density": 2700.0, "poisson": 0.3}
DAMPED = {"loss_factor": 0.01, "mass_damping": 2.0, "stiffness_damping": 3.0}
#: At least one of every type; a test fails where one is missing.
CASES: dict[str, tuple[Case, ...]] = {
    "bar": (
        Case("on a line", LINE, Bar("e", PAIRS, 2.0, 5.0, **DAMPED), 2.0 * lengths(LINE).sum()),
        Case("in a plane", PLANE, Bar("e", PAIRS, 2.0, 5.0), 2.0 * lengths(PLANE).sum()),
        Case("in space", SPACE, Bar("e", PAIRS, [2.0, 1.0], 5.0), lengths(SPACE) @ [2.0, 1.0]),
    ),
    "beam": (
        Case("on a line", LINE, Beam("e", PAIRS, [2.0, 3.0], [5.0, 7.0], **DAMPED), lengths(LINE) @ [2.0, 3.0]),
        Case(
            "in a plane",
            PLANE,
            Beam("e", PAIRS, 2.0, 5.0, 11.0, rotary_inertia=[0.3, 0.5], **DAMPED),
            2.0 * lengths(PLANE).sum(),
        ),
        Case(
            "with shear on a line",
            LINE,
            Beam("e", PAIRS, 2.0, [5.0, 7.0], shear_stiffness=[9.0, 20.0], rotary_inertia=0.4, **DAMPED),
            2.0 * lengths(LINE).sum(),
        ),
        Case(
            "with shear in a plane",
            PLANE,
            Beam("e", PAIRS, 2.0, 5.0, 11.0, shear_stiffness=9.0, **DAMPED),
            2.0 * lengths(PLANE).sum(),
        ),
    ),
    "dashpot": (Case("between masses", LINE, Dashpot("e", "1X", "2X-", viscous_damping=3.0)),),
    "friction": (Case("between masses", LINE, Friction("e", "1X", "2X", friction_force=3.0, measured_by="3X")),),
    "joint": (
        Case(
            "in a plane",
            PLANE,
            Joint("e", "frame:2", "2RZ", 3.0, 0.1),
            lengths(PLANE).sum(),
            beside=(Beam("frame", PAIRS, 1.0, 2.0, 5.0),),
        ),
        Case(
            "in space",
            SPACE,
            Joint("e", "frame:1", "2X", 3.0),
            lengths(SPACE).sum(),
            beside=(SpaceBeam("frame", PAIRS, 1.0, 2.0, 3.0, 5.0, 4.0),),
        ),
    ),
    "membrane": (
        on_cells("consistent", "triangle", lambda t: Membrane("e", t, 2.0, 3.0, 0.01, 0.1), 1.2),
        on_cells("lumped", "triangle", lambda t: Membrane("e", t, 2.0, 3.0, lumped=True), 1.2),
    ),
    "plane": (
        on_cells("quad", "quad", lambda t: Plane("e", t, thickness=0.1, **ELASTIC, **DAMPED), 162.0),
        on_cells("triangle6", "triangle6", lambda t: Plane("e", t, thickness=0.1, state="strain", **ELASTIC), 162.0),
    ),
    "plate": (on_cells("quad", "quad", lambda t: Plate("e", t, thickness=0.1, **ELASTIC, **DAMPED), 162.0),),
    "point_mass": (
        Case("in space", SPACE, PointMass("e", [1, 3], [4.0, 5.0]), 9.0),
        Case("one direction", PLANE, PointMass("e", [1, 3], [4.0, 5.0], directions=("Y",)), 9.0),
    ),
    "rotary_inertia": (Case("about Y", SPACE, RotaryInertia("e", [1, 3], [0.5, 0.7], "RY")),),
    "shell": (
        on_cells(
            "quad",
            "quad",
            lambda t: Shell("e", t, thickness=0.1, linear_strains=1.0, **ELASTIC, **DAMPED),
            162.0 * np.sqrt(1.25),
            rise=lambda p: 0.5 * p[:, 0],
        ),
    ),
    "solid": (
        on_cells(
            "hexahedron", "hexahedron", lambda t: Solid("e", t, **ELASTIC, **DAMPED), 648.0, (2, 1, 1), (1, 0.6, 0.4)
        ),
        on_cells("tetra", "tetra", lambda t: Solid("e", t, **ELASTIC), 648.0, (1, 1, 1), (1, 0.6, 0.4)),
    ),
    "space_beam": (
        Case(
            "in space",
            SPACE,
            SpaceBeam("e", PAIRS, 2.0, 5.0, 6.0, 11.0, 3.0, 0.1, 0.01, 0.2, orientation=[0.1, 0.2, 0.9]),
            2.0 * lengths(SPACE).sum(),
        ),
        Case(
            "with shear",
            SPACE,
            SpaceBeam(
                "e",
                PAIRS,
                2.0,
                [5.0, 3.0],
                6.0,
                11.0,
                3.0,
                shear_stiffness_y=9.0,
                shear_stiffness_z=[8.0, 7.0],
                rotary_inertia_y=0.3,
                rotary_inertia_z=[0.4, 0.2],
            ),
            2.0 * lengths(SPACE).sum(),
        ),
    ),
    "spring": (
        Case("between masses", LINE, Spring("e", ["1X", "2X"], ["2X", "3X"], stiffness=[3.0, 4.0], loss_factor=0.1)),
        Case("to the ground", SPACE, Spring("e", ["1X", "2RZ"], stiffness=3.0), turns=False),
    ),
}
for _membrane in CASES["membrane"]:  # tension holds it against turning
    object.__setattr__(_membrane, "turns", False)


def cases():
    """Every case of every type of the registry, as arguments of a test."""
    return [pytest.param(case, id=f"{name} {case.name}") for name in ELEMENT_TYPES for case in CASES[name]]


def rigid_motions(structure: Structure) -> np.ndarray:
    """All rigid motions of the structure as columns on its degrees of freedom."""
    motions = np.zeros((structure.n_dofs, 6))
    for i, dof in enumerate(structure.dofs):
        x = np.zeros(3)
        loosened = [element.loosened[1].node for element in structure.elements if element.loosened]
        x[: structure.dimension] = structure.nodes[dof.node if dof.node in structure.nodes else loosened[0]]
        motions[i, dof.axis] = 1.0
        if not dof.is_rotation:
            motions[i, 3:] = np.cross(np.eye(3), x)[:, dof.axis]
    return motions


def properties(case: Case) -> dict:
    """Declared properties of the element that have a value."""
    said = declarations(case.element)
    own = {name: getattr(case.element, name) for name, what in said.items() if what.kind is not None}
    assert all(said[name].optional for name, value in own.items() if value is None)
    return {name: value for name, value in own.items() if value is not None}


def keeps_symmetry(case: Case, folder: Path) -> None:
    """Matrices are symmetric and positive semidefinite."""
    parts = [(part, part.blocks.assemble(np.ones(part.blocks.n_elements))) for part in case.structure.contributions]
    alone = [matrix for part, matrix in parts if part.scale is None]
    for found in (*alone, *(case.structure.matrix(law) for law in {part.matrix_kind for part, _ in parts})):
        matrix = found.toarray()
        assert np.abs(matrix - matrix.T).max() <= 1e-13 * np.abs(matrix).max()
        assert np.linalg.eigvalsh(matrix).min() >= -1e-12 * np.abs(matrix).max()


def resists_no_rigid_motion(case: Case, folder: Path) -> None:
    """Stiffness does not notice rigid motions, but where the ground holds it."""
    structure = case.structure
    motions = rigid_motions(structure)[:, : 6 if case.turns else 3]
    stiffness = structure.matrix("stiffness").toarray()
    force = np.abs(stiffness @ motions).max(initial=0.0)
    free = force <= 1e-11 * np.abs(stiffness).max(initial=0.0) * np.abs(motions).max(initial=0.0)
    assert free == (case.name != "to the ground")


def carries_its_mass(case: Case, folder: Path) -> None:
    """A rigid translation carries the whole mass, in every direction in which it moves."""
    structure = case.structure
    assert structure.mass_of() == pytest.approx(case.mass, rel=1e-12)
    for axis in range(3):
        motion = np.array([float(d.axis == axis) for d in structure.dofs])
        if motion.any() and case.mass:
            assert motion @ (structure.matrix("mass") @ motion) == pytest.approx(case.mass, rel=1e-12)


def follows_its_values(case: Case, folder: Path) -> None:
    """Matrices at other values are those of an element set made with them, powers of the thickness included."""
    base = case.structure
    own = {item.term.property: item for item in base.properties if item.element == case.element.name}
    for name, nominal in properties(case).items():
        changed = 1.3 * nominal + 0.1
        made = case.made(replace(case.element, **{name: changed}))
        values = base.values.copy()
        if name in own:
            values[own[name].values] = changed
            assert own[name].term.unit
        for law in {part.matrix_kind for part in made.contributions}:
            expected = made.matrix(law).toarray()
            assert base.matrix(law, values).toarray() == pytest.approx(
                expected, rel=1e-12, abs=1e-14 * np.abs(expected).max()
            )


def damps_as_its_name_says(case: Case, folder: Path) -> None:
    """Damping by mass acts on rigid translations as the mass does, damping by strain rate on none."""
    own = properties(case)
    for name in {"mass_damping", "stiffness_damping"} & set(own):
        others = {other: 0.0 for other in own if other.endswith("damping")}
        weights = own.get("mass", own.get("density"))
        made = case.made(replace(case.element, **{**others, name: weights}))
        damping, mass = made.matrix("damping"), made.matrix("mass")
        assert damping.nnz
        for axis in range(3):
            motion = np.array([float(d.axis == axis) for d in made.dofs])
            expected = motion @ mass @ motion if name == "mass_damping" else 0.0
            assert motion @ damping @ motion == pytest.approx(expected, rel=1e-10, abs=1e-8 * abs(damping).max())


def refuses_bad_values(case: Case, folder: Path) -> None:
    """Every property is a finite number of at least 0 (forces of either sign), one for all or one an element."""
    for name, what in declarations(case.element).items():
        if what.kind is None:
            continue
        if what.unlimited:
            assert getattr(replace(case.element, **{name: np.inf}), name) is None
        infinite = np.full(len(case.element.nodes), np.inf) if what.unlimited else np.inf
        negative = () if what.kind == "axial_force" else (-1.0,)
        for bad in (*negative, np.nan, infinite, np.ones(99), *([0.0] if what.positive else [])):
            with pytest.raises(InputError, match=f"`{name}` of 'e' must be"):
                replace(case.element, **{name: bad})


def says_what_it_takes(case: Case, folder: Path) -> None:
    """Every argument stands in the signature and, with its unit, in the docstring."""
    kind = type(case.element)
    text, said = inspect.getdoc(kind) or "", declarations(kind)
    arguments = [item.name for item in fields(kind) if item.init]
    assert set(inspect.signature(kind).parameters) == set(arguments)
    for name in arguments:
        assert f"\n{name} : " in text
        assert said[name].words in text
        assert said[name].unit in text
        assert (said[name].kind is None) == (said[name].unit == "")


def travels(case: Case, folder: Path) -> None:
    """It reaches another process as it is."""
    again = pickle.loads(pickle.dumps(case.element))
    assert same(case.structure, case.made(again))


def same(first: Structure, second: Structure) -> bool:
    laws = {part.matrix_kind for part in first.contributions}
    return first.dofs == second.dofs and all(
        np.array_equal(first.matrix(law).toarray(), second.matrix(law).toarray()) for law in laws
    )


def is_written_in_a_study(case: Case, folder: Path) -> None:
    """The same element set comes from a study file whose keys are its arguments."""
    table = {"nodes": {str(label): plain(np.atleast_1d(x)) for label, x in case.nodes.items()}}
    for element in (*case.beside, case.element):
        [name] = [name for name, kind in ELEMENT_TYPES.items() if kind is type(element)]
        entry = {key: plain(getattr(element, key)) for key in element_table(type(element)).keys if key != "group"}
        table[name] = [{key: value for key, value in entry.items() if value is not None}]
    section = Section(StudyText(folder / "study.toml", ""), ("structure",), table)
    assert same(case.structure, read_structure(section, InputFiles(folder)))


def plain(value: object) -> object:
    """A field of an element set as TOML has it."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Dof):
        return str(value)
    if isinstance(value, tuple):
        texts = [str(entry) for entry in value]
        return texts[0] if len(texts) == 1 else texts or None
    return value


LAWS = (
    keeps_symmetry,
    resists_no_rigid_motion,
    carries_its_mass,
    follows_its_values,
    damps_as_its_name_says,
    refuses_bad_values,
    says_what_it_takes,
    travels,
    is_written_in_a_study,
)
