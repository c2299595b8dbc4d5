"""Predictions with 95 % bands: one function sends the uncertainty of a model through any quantity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TypeAlias

import numpy as np

from structid.core.arrays import FloatArray, NumberArray, locked
from structid.core.display import Overview, Shown, format_number, plural
from structid.core.dof import Dof
from structid.core.errors import InputError, SingularModelError
from structid.fem import Structure
from structid.identification.identified import Identification
from structid.prediction.changes import Change, changed_model
from structid.prediction.identified_model import IdentifiedModel, model_of
from structid.prediction.model_error import ModelError
from structid.prediction.options import N_DRAWS
from structid.prediction.participation import ModalParticipation
from structid.prediction.quantities import (
    DerivedQuantity,
    Evaluator,
    Frf,
    History,
    NaturalModes,
    Quantity,
    Spectrum,
    comparable_modes,
)
from structid.prediction.recovery import is_von_mises
from structid.unknowns import Parameters

#: A quantity by the identified model, and by each of the random models, (n_draws, ...).
_ValueAndDraws: TypeAlias = tuple[NumberArray, NumberArray]
LEVEL = 0.95
#: Standard deviations off at which motions are put into a basis, and how many independent errors are.
_OFF, _MOST_POINTS = 2.0, 12
_FEWEST = 50


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Shown):
    """A predicted quantity.

    Attributes
    ----------
    quantity : Quantity
    values : array
        By the identified model, with the axes of `quantity`.
    low, high : float arrays of that shape
        Ends of the 95 % interval, at every point by itself: of the magnitude where values are complex.
    std : float array of that shape
        Standard deviation; of complex values the root of E|error|^2.
    n_draws : int
        Random models behind the band.
    words : str
        What the band includes.
    draws : (n_draws, ...) array, optional
        The quantity by each of the random models, which are its distribution; not kept along axes of time and frequency.
    """

    quantity: Quantity
    values: NumberArray
    low: FloatArray
    high: FloatArray
    std: FloatArray
    n_draws: int
    words: str
    draws: NumberArray | None = None

    def overview(self) -> Overview:
        """A line with quantity, axes, unit and median half-width of the 95 % band, in % of the value; no table."""
        size = np.abs(self.values)
        part = np.divide(self.high - self.low, 2 * size, out=np.zeros(size.shape), where=size > 0)
        axes = ", ".join(plural(len(entries), name) for name, entries in self.quantity.axes.items())
        words = f"{type(self.quantity).__name__} of {axes}, {self.quantity.unit}; half-width of the 95 % band: median"
        words += f" {format_number(100 * float(np.median(part)), 3)} % of the value"
        return Overview("; ".join(filter(None, (words, self.words))), (), ())


@dataclass(frozen=True, eq=False, repr=False)
class PredictedChange(Shown):
    """A quantity before and after a change of the structure; errors that both share cancel in the difference.

    Attributes
    ----------
    before, after : Prediction
    difference : Prediction
        After less before; of complex values the difference of magnitudes.
    """

    before: Prediction
    after: Prediction
    difference: Prediction

    def overview(self) -> Overview:
        """A line with the quantity, and a table of its values before, after and of the change, with the deviation of the change.

        The table has a row for each value, and none if an axis is time or frequency.
        """
        quantity, axes = self.before.quantity, self.before.quantity.axes
        words = f"{type(quantity).__name__} before and after a change, {quantity.unit}"
        if not all(isinstance(entry, str) for entries in axes.values() for entry in entries):
            return Overview(words, (), ())
        labels = [" ".join(map(str, entries)) for entries in product(*axes.values())]
        columns = (self.before.values, self.after.values, self.difference.values, self.difference.std)
        cells = [
            [format_number(float(value), digits) for value in np.real(column).ravel()]
            for column, digits in zip(columns, (5, 5, 3, 2), strict=True)
        ]
        header = (" ".join(axes), "before", "after", "change", "± change")
        return Overview(words, header, list(zip(labels, *cells, strict=True)))


def predict(
    source: Identification | IdentifiedModel,
    quantity: Quantity,
    n_draws: int = N_DRAWS,
    seed: int = 0,
    model_error: ModelError | None = None,
) -> Prediction:
    """A prediction of a quantity by an identified model, with a 95 % band.

    Parameters
    ----------
    source : Identification or IdentifiedModel
    quantity : Quantity
        `Frf`, `History`, `Maxima`, `Spectrum`, `RootMeanSquare`, `Extremes`, `NaturalModes` or `ModalParticipation`.
    n_draws : int
        Random models within the uncertainty from which the band is made.
    seed : int
        Of the random models.
    model_error : ModelError, optional
        What the fitted responses missed beyond noise, which bands of FRFs, histories, spectra and what follows from them then
        include; by default that of an identification whose fit misses the noise.

    Raises
    ------
    NoAnswerError
        If the data do not determine the model.
    InputError
        If a sensor or load is not part of the structure, or the quantity has no meaning for it.

    Examples
    --------
    >>> import structid as sid  # doctest: +SKIP
    >>> found = sid.run_study(sid.load_study("frame.toml")).identification  # doctest: +SKIP
    >>> sid.predict(found, sid.Frf(["401X+"], ["103X+"], np.linspace(20, 150, 500)))  # doctest: +SKIP
    """
    return predict_together(source, [quantity], n_draws, seed, model_error)[0]


def predict_together(
    source: Identification | IdentifiedModel,
    quantities: Sequence[Quantity],
    n_draws: int = N_DRAWS,
    seed: int = 0,
    model_error: ModelError | None = None,
) -> list[Prediction]:
    """Predictions of several quantities, in their order, by the same random models.

    A history and its `Maxima` are computed once.

    Parameters
    ----------
    source : Identification or IdentifiedModel
    quantities : sequence of Quantity
    n_draws, seed : int
        Number of random models within the uncertainty from which bands are made, at least 50, and what fixes them.
    model_error : ModelError, optional
        What the fitted responses missed beyond noise; by default that of an identification whose fit misses the noise.

    Raises
    ------
    NoAnswerError
        If the data do not determine the model.
    InputError
        If a sensor or load is not part of the structure, a quantity has no meaning for it, or `n_draws` is below 50.
    """
    model, error = model_and_error(source, model_error)
    _require_quantities(quantities)
    drawn = _draw_all(model, model.structure, model.parameters, quantities, n_draws, seed)
    return _predict_all(quantities, drawn, model.words, error, seed)


def predict_change(
    source: Identification | IdentifiedModel,
    quantity: Quantity,
    changes: Sequence[Change],
    n_draws: int = N_DRAWS,
    seed: int = 0,
    model_error: ModelError | None = None,
) -> PredictedChange:
    """Quantity before and after changes of the structure, and the difference with its 95 % band.

    Modes after the changes are those that are most like the ones before, in their order, also where a damper adds a
    mode or a support takes one away.

    Parameters
    ----------
    source : Identification or IdentifiedModel
    quantity : Quantity
    changes : sequence of Change
        In the order in which they are made: `AddMass`, `Scale`, `Remove`, `AddTunedMassDamper` and others.
    n_draws, seed : int
        Number of random models within the uncertainty from which bands are made, and what fixes them.
    model_error : ModelError, optional
        What the fitted responses missed beyond noise; by default that of an identification whose fit misses the noise.
        The difference is without it, since a change does not change what the model misses.

    Raises
    ------
    NoAnswerError
        If the data do not determine the model.
    InputError
        If the quantity or a change names what the structure does not have, or the changed structure has no modes.
    """
    return predict_changes(source, [quantity], changes, n_draws, seed, model_error)[0]


def predict_changes(
    source: Identification | IdentifiedModel,
    quantities: Sequence[Quantity],
    changes: Sequence[Change],
    n_draws: int = N_DRAWS,
    seed: int = 0,
    model_error: ModelError | None = None,
) -> list[PredictedChange]:
    """Several quantities before and after changes, in their order, by the same random models, with their differences.

    Modes after the changes are those most like the ones before, in their order.

    Parameters
    ----------
    source : Identification or IdentifiedModel
    quantities : sequence of Quantity
    changes : sequence of Change
        In the order in which they are made.
    n_draws, seed : int
        Number of random models within the uncertainty from which bands are made, and what fixes them.
    model_error : ModelError, optional
        What the fitted responses missed beyond noise; by default that of an identification whose fit misses the noise.
        The differences are without it.

    Raises
    ------
    NoAnswerError
        If the data do not determine the model.
    InputError
        If a quantity or change names what the structure does not have, or the changed structure has no modes.
    """
    model, error = model_and_error(source, model_error)
    _require_quantities(quantities)
    changed, parameters = changed_model(model.structure, model.parameters, changes)
    wanted, followed = list(quantities), list(quantities)
    for i, quantity in enumerate(quantities):
        if isinstance(quantity, NaturalModes | ModalParticipation):
            after_values = parameters.values(model.physical)
            lowest = NaturalModes(quantity.n_modes)
            pair = comparable_modes(lowest, (model.structure, model.values), (changed, after_values))
            wanted[i], followed[i] = (replace(quantity, n_modes=m.n_modes, reference=m.reference) for m in pair)
    all_before = _draw_all(model, model.structure, model.parameters, wanted, n_draws, seed)
    all_after = _draw_all(model, changed, parameters, followed, n_draws, seed)
    differences = [
        _band(quantity, *_difference(quantity, before, after), model.words)
        for quantity, before, after in zip(wanted, all_before, all_after, strict=True)
    ]
    both = (_predict_all(wanted, drawn, model.words, error, seed) for drawn in (all_before, all_after))
    return [PredictedChange(*three) for three in zip(*both, differences, strict=True)]


def _require_quantities(quantities: Sequence[object]) -> None:
    """Raise `InputError` for what is no quantity, such as the name of a sensor, or a class in place of its object."""
    for quantity in quantities:
        if isinstance(quantity, type) or not hasattr(quantity, "evaluator"):
            raise InputError(
                "`quantity` must be an Frf, History, Maxima, Spectrum, RootMeanSquare, Extremes, NaturalModes or"
                f" ModalParticipation, got {quantity!r}; for a sensor give its FRFs, such as Frf(['3Y'], ['8Y'], frequency), or"
                " its History under loads"
            )


def model_and_error(
    source: Identification | IdentifiedModel, model_error: ModelError | None
) -> tuple[IdentifiedModel, ModelError | None]:
    """Identified model of `source`, and the model error to use: `model_error`, or that of its first fit, or None.

    The error of a fit is used only for an identification whose covariance is based on model error. An `IdentifiedModel` and
    `model_error` are returned as they are.
    """
    model = model_of(source)
    if isinstance(source, IdentifiedModel):
        return model, model_error
    if model_error is None and source.fits and source.estimate.covariance_basis == "model_error":
        fit, physical = source.fits[0], source.estimate.values[source.own_index]
        problem = fit.problem
        model_error = ModelError.of_fit(problem.structure, problem.parameters, physical, problem.record, fit.predicted)
    return model, model_error


def _draw_all(
    model: IdentifiedModel,
    structure: Structure,
    parameters: Parameters,
    quantities: Sequence[Quantity],
    n_draws: int,
    seed: int,
) -> list[_ValueAndDraws]:
    """Base of each quantity by the identified model, and by each of the random models, (n_draws, ...), as pairs.

    The base is what a quantity is derived from, as a history for its maxima, or the quantity itself. `structure` and
    `parameters` may be those after a change. `InputError` for fewer than 50 draws. `seed` fixes the random models.
    `quantities` are what is predicted.
    """
    if n_draws < _FEWEST:
        raise InputError(f"`n_draws` must be at least {_FEWEST} for a 95 % band, got {n_draws}")
    physical = model.draw_parameters(n_draws, np.random.default_rng(seed))
    computed: dict[int, _ValueAndDraws] = {}
    for quantity in quantities:
        base = _base_of(quantity)
        if id(base) not in computed:
            evaluate = base.evaluator(structure, parameters, parameter_points(model))
            nominal = evaluate(model.physical)
            computed[id(base)] = nominal, np.stack([_evaluated(evaluate, each) for each in physical])
    return [computed[id(_base_of(quantity))] for quantity in quantities]


def _base_of(quantity: Quantity) -> Quantity:
    """The quantity that is computed for each random model: the one from which it follows, or itself."""
    return quantity.base if isinstance(quantity, DerivedQuantity) else quantity


def _derive(quantity: Quantity, drawn: _ValueAndDraws) -> _ValueAndDraws:
    """Derived quantity, such as a maximum, of its base (a history): the pair `drawn` of value and draws, mapped by it.

    `drawn` has the values by the identified model and (n_draws, ...) those by the random ones. It is returned as it is
    if the quantity is not derived from another.
    """
    if not isinstance(quantity, DerivedQuantity):
        return drawn
    nominal, draws = drawn
    return quantity.derived(nominal), np.stack([quantity.derived(each) for each in draws])


def _difference(quantity: Quantity, before: _ValueAndDraws, after: _ValueAndDraws) -> _ValueAndDraws:
    """Derived quantity after less before, by the identified and by each random model; of complex values that of magnitudes."""
    pairs = zip(_derive(quantity, before), _derive(quantity, after), strict=True)
    nominal, draws = (np.abs(b) - np.abs(a) if np.iscomplexobj(a) else b - a for a, b in pairs)
    return nominal, draws


def _evaluated(evaluate: Evaluator, physical: FloatArray) -> NumberArray:
    try:
        return evaluate(physical)
    except SingularModelError as error:
        raise SingularModelError(
            f"a model within the uncertainty cannot be computed: {error}; the parameters are known too badly to predict with"
        ) from error


def parameter_points(model: IdentifiedModel) -> list[FloatArray]:
    """Physical parameters, (n_params,) each, for a reduction: the identified ones, and up to 12 sets that are off.

    Each of these is off by two standard deviations of one of the largest independent errors of `model`, but no positive
    value is below 0.001 of the identified one.
    """
    order = np.argsort(-np.linalg.norm(model.factor, axis=0))[:_MOST_POINTS]
    lines = _OFF * np.eye(model.factor.shape[1])[order]
    return [model.physical, *map(model.moved_parameters, lines)]


def _predict_all(
    quantities: Sequence[Quantity], drawn: Sequence[_ValueAndDraws], words: str, error: ModelError | None, seed: int
) -> list[Prediction]:
    """Predictions of `quantities` from their bases `drawn` by the identified and the random models, with the model `error`.

    The error of a base is drawn once for all quantities that follow from it. `words` say what the uncertainty includes.
    `seed` fixes the random errors; None for `error` leaves them out.
    """
    missed: dict[int, NumberArray | None] = {}
    predictions = []
    for quantity, (nominal, draws) in zip(quantities, drawn, strict=True):
        base, said = _base_of(quantity), words
        if error is not None:
            if id(base) not in missed:
                missed[id(base)] = _with_model_error(base, nominal, draws, error, seed)
            if (widened := missed[id(base)]) is not None:
                draws, said = widened, f"{words}, and {error.words}" if words else error.words
        predictions.append(_band(quantity, *_derive(quantity, (nominal, draws)), said))
    return predictions


def _with_model_error(
    base: Quantity, nominal: NumberArray, draws: NumberArray, error: ModelError, seed: int
) -> NumberArray | None:
    """Draws (n_draws, ...) of FRFs, histories or spectra with random model errors added; None for other quantities.

    `nominal` are the values by the identified model, `draws` those by the random models; `seed` fixes the errors.
    `base` is the quantity, `error` the model error.
    """
    rng = np.random.default_rng(seed + 1)
    if isinstance(base, Frf):
        has_size = np.array([isinstance(each, Dof) and base.kind != "transmissibility" for each in base.outputs])
        return error.added_to(draws.astype(complex), base.frequency, base.kind, has_size, nominal.astype(complex), rng)
    if isinstance(base, History):
        widened = error.added_to_histories(draws.real, base.sampling_rate, rng)
        is_positive = np.array([is_von_mises(output) for output in base.outputs])
        return np.where(is_positive, np.maximum(widened, 0.0), widened)
    if isinstance(base, Spectrum):
        return error.added_to_spectra(draws.real, base.frf.frequency, rng)
    return None


def _band(quantity: Quantity, nominal: NumberArray, draws: NumberArray, words: str) -> Prediction:
    """Prediction with its 95 % band, from the values `nominal` by the identified model and `draws` (n_draws, ...) by random ones.

    `words` say what the uncertainty includes. Draws along axes of time or frequency are not kept. Of a model with fewer modes
    than were asked for the quantity of the prediction has these only.
    """
    if isinstance(quantity, NaturalModes | ModalParticipation) and len(nominal) < quantity.n_modes:
        quantity = replace(quantity, n_modes=len(nominal))
    sizes = np.abs(draws) if np.iscomplexobj(draws) else draws
    # between order statistics so that the truth, which is like one model more, lies inside with the probability LEVEL
    low, high = np.quantile(sizes, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0, method="weibull")
    std = np.sqrt(np.mean(np.abs(draws - nominal) ** 2, axis=0))
    kept = None if {"time", "frequency"} & set(quantity.axes) else locked(draws)
    return Prediction(quantity, nominal, low, high, std, len(draws), words, kept)
