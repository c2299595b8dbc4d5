"""An identified model as a distribution: a structure with parameters, how far off they may be, and a table of its elements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray, locked, square_root
from structid.core.errors import InputError, NoAnswerError
from structid.fem import Structure
from structid.forward.fixed_values import append_fixed_factors
from structid.identification.identified import Identification
from structid.unknowns import Parameters
from structid.unknowns.tolerances import Tolerances, fixed_properties

#: Tolerances by which every fixed property is listed; the study's own give the sizes.
_ANY = Tolerances(1.0, 1.0, 1.0, 1.0)
#: Standard deviation, in parts of a value, from which on it is drawn along a straight line.
_VAGUE = 0.5
#: A positive parameter is moved to no less than this part of its value.
_LEAST = 1e-3
#: Random models that are tried for one within all limits.
_MOST_TRIALS = 200


@dataclass(frozen=True, eq=False)
class IdentifiedModel:
    """A structure with identified parameters and the joint uncertainty of these and of the values that it holds fixed.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
        Those identified, followed by a factor (1 as identified) on every property that the model holds fixed within a tolerance.
    physical : (n_params,) float array
        Identified values.
    factor : (n_params, n_factors) float array
        Change of the free variables of `parameters` for one standard deviation of each independent error:
        their covariance is factor factor'.
    errors : tuple of str
        What each column of `factor` is owed to: ``data 1`` ..., then the fixed values.
    words : str
        What the uncertainty includes.
    """

    structure: Structure
    parameters: Parameters
    physical: FloatArray
    factor: FloatArray
    errors: tuple[str, ...]
    words: str = ""

    @property
    def values(self) -> FloatArray:
        """Identified property values of the structure, (n_values,)."""
        return self.parameters.values(self.physical)

    def parameters_at(self, z: FloatArray) -> FloatArray:
        """Physical parameters (n_params,) for standard normal errors `z` (n_factors,).

        Values that are known within half of their size move by their free variables. Others move in a straight line, so that
        what several of them share stays as it is; they may then come to lie outside their limits.
        """
        transforms = self.parameters.transforms
        theta, moves = transforms.free(self.physical), self.factor @ z
        along_line = self.physical + self.parameters.slope(theta) * moves
        return np.where(self._is_vague, along_line, transforms.physical(np.where(self._is_vague, theta, theta + moves)))

    def moved_parameters(self, z: FloatArray) -> FloatArray:
        """`parameters_at(z)`, but no positive parameter below 0.001 of its identified value: models that can be computed.

        Parameters of either sign, such as axial forces, are not limited.
        """
        moved = self.parameters_at(z)
        return np.where(self._lower >= 0, np.maximum(moved, _LEAST * self.physical), moved)

    def draw_parameters(self, n_draws: int, rng: np.random.Generator) -> FloatArray:
        """Random physical parameters within the uncertainty and the limits, (n_draws, n_params).

        Models outside the limits, or with a positive parameter that is not, are drawn again.

        Raises
        ------
        InputError
            If `n_draws` is below 1.
        NoAnswerError
            If fewer than `n_draws` of 200 times as many random models lie within the limits.
        """
        if n_draws < 1:
            raise InputError(f"`n_draws` must be at least 1, got {n_draws}")
        lower, upper = self._lower, self.parameters.transforms.bounds[:, 1]
        drawn: list[FloatArray] = []
        for _ in range(_MOST_TRIALS * n_draws):
            physical = self.parameters_at(rng.standard_normal((self.factor.shape[1],)))
            if ((physical > lower) & (physical < upper)).all():
                drawn.append(physical)
                if len(drawn) == n_draws:
                    return np.stack(drawn)
        vague = [name for name, is_vague in zip(self.parameters.names, self._is_vague, strict=True) if is_vague]
        raise NoAnswerError(
            f"{', '.join(vague)} are known so badly that nearly every model within their uncertainty is impossible; fix them, give"
            " priors, or measure more places, and identify again"
        )

    @property
    def _lower(self) -> FloatArray:
        """Lower limits (n_params,): 0 of positive parameters, minus infinity of those without any."""
        transforms = self.parameters.transforms
        return np.where(np.array(transforms.kinds, dtype=object) == "log", 0.0, transforms.bounds[:, 0])

    @property
    def _is_vague(self) -> np.ndarray:
        """A mask (n_params,) of the parameters that are uncertain by more than half of their size."""
        slope = self.parameters.slope(self.parameters.transforms.free(self.physical))
        spread = np.abs(slope) * np.linalg.norm(self.factor, axis=1)
        return np.asarray(spread > _VAGUE * np.abs(self.physical))


def identified_model(
    structure: Structure,
    parameters: Parameters,
    physical: FloatArray,
    covariance: FloatArray,
    fixed: Mapping[str, float] | None = None,
    fixed_changes: FloatArray | None = None,
    words: str = "",
) -> IdentifiedModel:
    """An `IdentifiedModel` from estimated parameters, their covariance, and the influence of fixed values on them.

    A fixed value that is off by one tolerance changes the parameters by its column of `fixed_changes` and the model by
    itself. Both are one error here, so that what cancels in the fitted responses cancels in a prediction too. The
    effect of second order is an error of its own, which changes the parameters alone.

    Parameters
    ----------
    structure : Structure
    parameters : Parameters
        Of that structure.
    physical : (n_params,) float array
        Identified values.
    covariance : (n_params, n_params) float array
        Of the data alone: by noise, or by model error where the fit misses the noise; physical units.
    fixed : mapping of str to float, optional
        What each column of `fixed_changes` is owed to, such as ``mass[deck]``, and its tolerance as a part of the
        value. What is no property of the structure, such as the calibration of a record or `SECOND_ORDER`, changes the
        parameters alone.
    fixed_changes : (n_params, n_fixed) float array, optional
        Change of each parameter, physical units, for one tolerance of each fixed value: `FixedValueInfluence.changes`.
    words : str
        What the uncertainty includes.

    Returns
    -------
    IdentifiedModel
        Its parameters are the given ones and, behind them, a factor of 1 on each property that `fixed` names.

    Raises
    ------
    NoAnswerError
        If a parameter has no finite variance: the data do not determine it.
    InputError
        If shapes do not fit.
    """
    n, tolerances = parameters.n_params, fixed or {}
    changes = np.zeros((n, 0)) if fixed_changes is None else np.asarray(fixed_changes, dtype=np.float64)
    if covariance.shape != (n, n) or changes.shape != (n, len(tolerances)):
        raise InputError(
            f"`covariance` must be ({n}, {n}) and `fixed_changes` ({n}, {len(tolerances)}), got {covariance.shape} and"
            f" {changes.shape}; take both from one estimate"
        )
    spread = np.diag(covariance) + (changes**2).sum(axis=1)
    unknown = [name for name, size in zip(parameters.names, spread, strict=True) if not np.isfinite(size)]
    if unknown:
        raise NoAnswerError(
            f"the data do not determine {', '.join(unknown)}, so that no prediction has a band; fix or tie these parameters,"
            " give a prior, or measure more places, and identify again"
        )
    noise, slope = square_root(covariance), parameters.slope(parameters.transforms.free(physical))
    held = tuple(item for item in fixed_properties(structure, parameters, _ANY) if item.label in tolerances)
    factor = np.zeros((n + len(held), noise.shape[1] + changes.shape[1]))
    factor[:n] = np.hstack([noise, changes]) / slope[:, None]
    columns = {name: column for column, name in enumerate(tolerances, noise.shape[1])}
    for row, item in enumerate(held, n):
        factor[row, columns[item.label]] = tolerances[item.label]
    return IdentifiedModel(
        structure,
        append_fixed_factors(parameters, held),
        locked(np.concatenate([physical, np.ones(len(held))])),
        locked(factor),
        (*(f"data {i + 1}" for i in range(noise.shape[1])), *tolerances),
        words,
    )


def model_of(identification: Identification | IdentifiedModel) -> IdentifiedModel:
    """Identified model, with parameters and joint uncertainty, of an identification; an identified model as it is.

    Raises
    ------
    InputError
        If `identification` is neither.
    NoAnswerError
        If the data do not determine a parameter, or a matrix-free search gave no covariance matrix.
    """
    if isinstance(identification, IdentifiedModel):
        return identification
    if not isinstance(identification, Identification):
        raise InputError(
            "an identification is needed, as `identify` and `identify_together` give it and `run_study` has it as"
            f" `.identification`, got {type(identification).__name__}"
        )
    estimate, index = identification.estimate, identification.own_index
    if not estimate.uncertainty.has_matrix:
        raise NoAnswerError(
            "a matrix-free search gives no covariance matrix to predict with; group the unknowns, so that a dense search is used"
        )
    influence = estimate.fixed
    tolerances = changes = None
    if influence is not None:
        tolerances = dict(zip(influence.change_names, influence.change_tolerances, strict=True))
        changes = influence.changes[index]
    return identified_model(
        identification.structure,
        identification.parameters,
        estimate.values[index],
        estimate.covariance_of_data[np.ix_(index, index)],
        tolerances,
        changes,
        identification.assumption,
    )


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
        """Change as a part of the initial value, (n_elements,); NaN where that is 0 or the value is no unknown."""
        is_defined = self.is_sought & (self.initial != 0)
        return np.divide(
            self.value - self.initial, self.initial, out=np.full(len(self.value), np.nan), where=is_defined
        )

    @property
    def significance(self) -> FloatArray:
        """Change in standard deviations, (n_elements,), beyond 1.96 outside the 95 % interval; NaN for no unknown."""
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
