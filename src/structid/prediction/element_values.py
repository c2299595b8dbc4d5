"""Table of the elements of an identified model: value, change, deviation and significance of each property."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.prediction.identified_model import IdentifiedModel


@dataclass(frozen=True, eq=False)
class ElementValues:
    """One property of an element set, before and after identification.

    Attributes
    ----------
    element : str
        The element set, or the component.
    name : str
        Such as ``bending_stiffness``.
    unit : str
    initial, value : (n_elements,) float arrays
        Before and after identification.
    std : (n_elements,) float array
        Standard deviation of `value`: by data and tolerances where a parameter acts on it, else by its own tolerance.
    is_sought : (n_elements,) bool array
        True where a parameter acts on it.
    """

    element: str
    name: str
    unit: str
    initial: FloatArray
    value: FloatArray
    std: FloatArray
    is_sought: np.ndarray

    @property
    def relative_change(self) -> FloatArray:
        """Change as a part of the initial value, NaN where that is 0 or nothing was sought."""
        is_defined = self.is_sought & (self.initial != 0)
        return np.divide(
            self.value - self.initial, self.initial, out=np.full(len(self.value), np.nan), where=is_defined
        )

    @property
    def significance(self) -> FloatArray:
        """Change in standard deviations, beyond 1.96 outside the 95 % interval; NaN where none was sought."""
        is_defined = self.is_sought & (self.std > 0)
        return np.divide(self.value - self.initial, self.std, out=np.full(len(self.value), np.nan), where=is_defined)


def element_values(model: IdentifiedModel, initial: FloatArray, covariance: FloatArray) -> tuple[ElementValues, ...]:
    """Initial and identified values, and their deviations, of every property of the element sets of an identified model.

    Parameters
    ----------
    model : IdentifiedModel
    initial : (n_parameters,) float array
        Values of the identified parameters before identification; factors on fixed values are not among them.
    covariance : (n_parameters, n_parameters) float array
        Of the same parameters, with all that their deviations include.

    Returns
    -------
    tuple of ElementValues
        One for each property of each element set: name, unit, values before and after, standard deviations, and a mask of values
        on which a parameter acts, (n_elements,) each. Fixed values have the deviation of their own tolerance.
    """
    n, parameters = len(initial), model.parameters
    design = parameters.design.tocsr()
    sought, fixed = design[:, :n], design[:, n:]
    before = parameters.values(np.concatenate([initial, model.physical[n:]]))
    variance = np.asarray((sought @ covariance * sought.toarray()).sum(axis=1)).ravel()
    variance += ((fixed @ model.factor[n:]) ** 2).sum(axis=1)
    is_sought = np.diff(sought.indptr) > 0
    return tuple(
        ElementValues(
            item.element,
            item.term.property,
            item.term.unit,
            before[item.values],
            model.values[item.values],
            np.sqrt(np.maximum(variance[item.values], 0.0)),
            is_sought[item.values],
        )
        for item in model.structure.properties
    )
