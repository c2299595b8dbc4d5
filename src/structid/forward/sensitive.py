"""Element matrices that the parameters of a structure weigh, and how their weights change with each parameter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.fem import Contribution, Structure
from structid.fem.blocks import ElementMatrices
from structid.forward.contraction import WeightedElements
from structid.unknowns import Parameters


def weight_slope(part: Contribution, unknown: Parameters, values: FloatArray) -> sparse.csr_array:
    """Derivative of the element weights of one contribution with respect to the parameters, (n_elements, n_params)."""
    return part.change(values, unknown.design.tocsr())


_REMEDIES = {"thickness": "take Young's modulus as the unknown", "position": "fix it"}


def require_linear_weights(structure: Structure, unknown: Parameters) -> None:
    """Raise `InputError` if a value that enters matrices non-linearly is a parameter or differs from the structure's.

    Such values are a thickness, a node coordinate, and bending and shear stiffness of a shear-flexible beam. Modal
    damping of the structure (`damping_ratio`) is refused too.
    """
    if structure.damping_ratio is not None:
        raise InputError(
            "modal damping (`damping_ratio` of all modes) is not linear in masses and stiffnesses, and these equations of motion"
            " are; fit spectra or output error, or FRFs, or take viscous elements in its place"
        )
    changing = (np.diff(unknown.design.tocsr().indptr) > 0) | (unknown.offset != structure.values)
    factors = nonlinear_values(structure)
    for item in structure.properties:
        if (factors[item.values] & changing[item.values]).any():
            remedy = _REMEDIES.get(item.term.kind, "leave the shear out")
            raise InputError(
                f"{item.label} must be known here, where equations of motion are linear in the parameters; {remedy}, or"
                f" identify the {item.term.property.replace('_', ' ')} from FRFs, spectra or output error"
            )


def nonlinear_values(structure: Structure) -> np.ndarray:
    """True for property values that enter matrices non-linearly, (n_values,) bool."""
    factors = np.zeros(len(structure.values), dtype=bool)
    for index in (index for part in structure.contributions if part.scale for index in part.scale.value_indices):
        factors[index] = True
    return factors


def require_matrices_in_time(structure: Structure, unknown: Parameters) -> None:
    """Raise `InputError` if the structure has friction or loss factors, which have no linear equation in time.

    Values of 0 that are no parameter count as absent.
    """
    touched = (np.diff(unknown.design.tocsr().indptr) > 0) | (unknown.offset != 0)
    for part in structure.contributions:
        if part.matrix_kind.startswith("friction:") and touched[part.value].any():
            raise InputError(
                f"friction {part.matrix_kind.removeprefix('friction:')!r} is not linear in the motion; take it out, or identify it"
                " from FRFs with `identify`"
            )
        if part.factor is not None and touched[part.factor].any():
            raise InputError(
                "loss factors have no equation in time (structural damping is defined for harmonic motion only); set them to 0"
                " and use viscous damping, or identify them from FRFs with `identify`"
            )


@dataclass(frozen=True, eq=False)
class SensitiveElements:
    """Elements of one family of blocks whose weights depend on the parameters, and the matrices in which they appear."""

    blocks: ElementMatrices
    rows: IntArray
    members: tuple[int, ...]


def sensitive_elements(structure: Structure, unknown: Parameters) -> tuple[SensitiveElements, ...]:
    """Families of element matrices whose weights depend on parameters, without elements that do not.

    Contributions with the same element matrices are one family, which names those contributions that depend on
    parameters.
    """
    touched = np.diff(unknown.design.tocsr().indptr) > 0
    families: dict[int, list[int]] = {}
    for member, part in enumerate(structure.contributions):
        families.setdefault(id(part.blocks), []).append(member)
    sensitive = []
    for members in families.values():
        masks = []
        for member in members:
            part = structure.contributions[member]
            masks.append(part.touched(touched))
        rows = np.flatnonzero(np.any(masks, axis=0))
        used = tuple(m for m, mask in zip(members, masks, strict=True) if mask.any())
        if len(rows):
            sensitive.append(SensitiveElements(structure.contributions[members[0]].blocks.take(rows), rows, used))
    return tuple(sensitive)


@dataclass(frozen=True, eq=False)
class WeightedParts:
    """All element matrices that the parameters weigh, and the matrices to which they add.

    Attributes
    ----------
    parts : tuple of WeightedElements
    members : tuple of (int, (n_elements,) int array)
        For each part: a contribution of the structure that has its matrices, and which of its elements they are.
    uses : tuple of tuples of (str, float)
        For each kind of part: the matrices to which it adds, each with a number that multiplies it.
    variable : tuple of float arrays
        Entries of the slopes that may change with the values of the parameters.
    """

    parts: tuple[WeightedElements, ...]
    members: tuple[tuple[int, IntArray], ...]
    uses: tuple[tuple[tuple[str, float], ...], ...]
    variable: tuple[FloatArray, ...]

    def same_slopes(self, other: WeightedParts) -> bool:
        """True where the part that may change is equal in both."""
        if [part.kind for part in self.parts] != [part.kind for part in other.parts]:
            return False
        return all(np.array_equal(a, b) for a, b in zip(self.variable, other.variable, strict=True))


def slope_value_indices(
    structure: Structure, unknown: Parameters, sensitive: tuple[SensitiveElements, ...]
) -> IntArray:
    """Indices (n,), sorted, of the property values on which the derivatives of element weights depend.

    A weight is a value times factors: the factors count, and the value too if a parameter changes a factor. `sensitive`
    are the families of element matrices whose weights depend on parameters.
    """
    counts, marks = np.diff(unknown.design.tocsr().indptr), np.zeros(len(unknown.offset), dtype=bool)
    for member in (member for group in sensitive for member in group.members):
        item = structure.contributions[member]
        for index in item.value_indices[1:]:
            marks[index] = True
            if counts[index].any():
                marks[item.value] = True
    return np.flatnonzero(marks)


def weighted_elements(
    structure: Structure, unknown: Parameters, sensitive: tuple[SensitiveElements, ...], physical: FloatArray
) -> WeightedParts:
    """Element matrices with the derivatives of their weights by the parameters, at `physical` (n_params,).

    A loss factor that is equal in all elements of a family, and no parameter, is a multiple of their stiffness: both
    matrices then share one part. Parts that enter the same matrices with the same factors are of one kind. `sensitive`
    are the families of element matrices whose weights depend on parameters.
    """
    weights, design = unknown.values(physical), unknown.design.tocsr()
    counts = np.diff(design.indptr)
    groups: dict[tuple[int, int, int], tuple[ElementMatrices, sparse.csr_array, list[tuple[str, float]]]] = {}
    members: list[tuple[int, IntArray]] = []
    variable: list[FloatArray] = []
    for number, group in enumerate(sensitive):
        for member in group.members:
            item = structure.contributions[member]
            factor = np.ones(1) if item.factor is None else weights[item.factor][group.rows]
            other = 0 if item.factor is None else counts[item.factor][group.rows].sum()
            if item.scale is not None:
                factor = factor * item.scale.of(weights)[group.rows]
                other += item.scale.touched(counts > 0)[group.rows].sum()
            simple = np.ptp(factor) == 0 and not other
            key = (number, item.first, -1 if simple else member)
            if key not in groups:
                slope = design[item.value] if simple else weight_slope(item, unknown, weights)
                groups[key] = (group.blocks, sparse.csr_array(slope[group.rows]), [])
                members.append((member, group.rows))
                variable += [] if simple else [groups[key][1].data]
            groups[key][2].append((item.matrix_kind, float(factor[0]) if simple else 1.0))
    kinds = {uses: kind for kind, uses in enumerate(dict.fromkeys(tuple(uses) for _, _, uses in groups.values()))}
    parts = tuple(WeightedElements(blocks, slope, kinds[tuple(uses)]) for blocks, slope, uses in groups.values())
    return WeightedParts(parts, tuple(members), tuple(kinds), tuple(variable))
