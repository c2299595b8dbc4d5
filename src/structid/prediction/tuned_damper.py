"""A tuned mass damper whose frequency and damping are best over the models within the uncertainty, not for one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.constraints import require_band
from structid.core.display import Overview, Shown, format_number
from structid.core.dof import Dof, parse_dof, parse_dofs
from structid.core.errors import InputError
from structid.identification.identified import Identification
from structid.prediction.changes import AddTunedMassDamper
from structid.prediction.identified_model import IdentifiedModel
from structid.prediction.predict import model_and_error, parameter_points
from structid.prediction.quantities import Frf, structure_modes

#: The default band reaches this part of a mode's frequency to each side of it, and has so many lines.
_AROUND, _LINES = 0.35, 1200
#: Modes among which that mode is chosen; below this part of the highest of their frequencies they are rigid motions.
_MODES, _RIGID = 20, 3e-5
#: Largest ratio of the damper's frequency to that where the search starts, either way, and largest damping ratio.
_FARTHEST, _MOST_DAMPED = 2.0, 1.0


@dataclass(frozen=True, eq=False, repr=False)
class TunedDamper(Shown):
    """Best values of a tuned mass damper, and the largest responses with it.

    Attributes
    ----------
    change : AddTunedMassDamper
        The damper, for `predict_change`.
    nominal : AddTunedMassDamper
        The one that is best for the identified model alone.
    peak, nominal_peak, peak_before : float
        Largest receptance in the band, m/N, that a stated part of the models stay below: with the damper, with the nominal one, and
        without.
    quantile : float
        That part.
    band : (float, float)
        Hz.
    n_draws : int
    """

    change: AddTunedMassDamper
    nominal: AddTunedMassDamper
    peak: float
    nominal_peak: float
    peak_before: float
    quantile: float
    band: tuple[float, float]
    n_draws: int

    def overview(self) -> Overview:
        """The values of both dampers and their largest responses."""
        rows = [
            (
                name,
                *(format_number(value, 4) for value in (damper.frequency, damper.damping_ratio)),
                format_number(peak, 3),
                format_number(100 * peak / self.peak_before, 3),
            )
            for name, damper, peak in (
                ("best over the uncertainty", self.change, self.peak),
                ("best for the identified model", self.nominal, self.nominal_peak),
            )
        ]
        words = (
            f"damper of {self.change.mass:g} kg at {parse_dof(self.change.dof).place}: largest receptance from"
            f" {format_number(self.band[0], 3)} to {format_number(self.band[1], 3)} Hz, below which {100 * self.quantile:g} % of"
            f" {self.n_draws} models within the uncertainty stay; without the damper {format_number(self.peak_before, 3)} m/N"
        )
        return Overview(
            words, ("damper", "frequency (Hz)", "damping ratio", "largest (m/N)", "of that without (%)"), rows
        )


def tune_damper(
    source: Identification | IdentifiedModel,
    dof: str | Dof,
    mass: float,
    outputs: Sequence[str | Dof] = (),
    inputs: Sequence[str | Dof] = (),
    band: tuple[float, float] | None = None,
    quantile: float = 0.95,
    n_draws: int = 100,
    seed: int = 0,
) -> TunedDamper:
    """The frequency and damping ratio of a tuned mass damper with which the largest response is smallest.

    The response counts below which `quantile` of the models within the uncertainty stay: a damper that is best for the
    identified model may be far off for others. The damper is coupled to the receptances of each model, so that no model
    is solved again.

    Parameters
    ----------
    source : Identification or IdentifiedModel
    dof : str or Dof
        A translation.
    mass : float
        kg.
    outputs, inputs : sequence of str or Dof
        Whose receptances count; the one at `dof` by default.
    band : (float, float), optional
        Hz; by default 35 % to each side of the mode that dominates the flexibility at `dof`. The damper is tuned to the
        mode that does so within the band.
    quantile : float
    n_draws, seed : int
        Number of the random models, at least 1, and what fixes them.

    Returns
    -------
    TunedDamper
        The best damper over the uncertainty and that for the identified model alone, and the largest receptances (m/N)
        with either and without.

    Raises
    ------
    InputError
        If `dof` is no translation of the structure, a number is out of its limits, `mass` is more than the mode moves
        as seen at `dof`, or no mode in the band moves at `dof`.
    NoAnswerError
        If the data do not determine the model.

    References
    ----------
    Den Hartog (1985), Mechanical Vibrations, section 3.3: the start of the search, and the answer for one undamped
    mass.
    """
    at_dof = parse_dof(dof)
    if at_dof.is_rotation:
        raise InputError(f"a tuned mass damper moves along X, Y or Z, got {at_dof}")
    if not (np.isfinite(mass) and mass > 0):
        raise InputError(f"`mass` must be greater than 0 kg, got {mass:g}")
    if not 0.5 <= quantile < 1:
        raise InputError(f"`quantile` must be at least 0.5 and less than 1, got {quantile:g}")
    model, _ = model_and_error(source, None)
    if band is not None:
        require_band("band", band, is_zero_allowed=False, is_open_allowed=False)
    tuned, effective = _dominant_mode(model, at_dof, band)
    if mass > effective:
        raise InputError(
            f"`mass` must be at most {effective:.4g} kg, what the mode at {tuned:.4g} Hz moves there, got {mass:g} kg;"
            " a damper is some per cent of that"
        )
    low, high = band or ((1 - _AROUND) * tuned, (1 + _AROUND) * tuned)
    read, pushed = parse_dofs(outputs) or (at_dof,), parse_dofs(inputs) or (at_dof,)
    sensors = tuple(dict.fromkeys((at_dof, *read)))
    loads = tuple(dict.fromkeys((at_dof, *pushed)))
    frf = Frf(sensors, loads, np.linspace(low, high, _LINES), "receptance")
    evaluate = frf.evaluator(model.structure, model.parameters, parameter_points(model))
    drawn = model.draw_parameters(n_draws, np.random.default_rng(seed))
    receptances = np.stack([np.asarray(evaluate(each), dtype=complex) for each in (model.physical, *drawn)])
    rows, columns = np.ix_([sensors.index(d) for d in read], [loads.index(d) for d in pushed])

    def peaks(receptance: ComplexArray) -> FloatArray:
        """Largest magnitude (...), m/N, at the chosen channels of `receptance` (..., n_lines, n_outputs, n_inputs)."""
        return np.asarray(np.abs(receptance[..., rows, columns]).max(axis=(-3, -2, -1)))

    def nominal_peak(frequency: float, ratio: float) -> float:
        return float(peaks(_couple_damper(receptances[0], frf.frequency, mass, frequency, ratio)))

    def peak_below(frequency: float, ratio: float) -> float:
        """Largest receptance, m/N, that a part `quantile` of the random models stays below with a damper.

        `frequency` (Hz) and damping `ratio` are those of the damper.
        """
        with_damper = _couple_damper(receptances[1:], frf.frequency, mass, frequency, ratio)
        return float(np.quantile(peaks(with_damper), quantile))

    mass_ratio = mass / effective
    start = tuned / (1 + mass_ratio), float(np.sqrt(3 * mass_ratio / (8 * (1 + mass_ratio))))
    nominal = _search(nominal_peak, start)
    robust = _search(peak_below, nominal)
    return TunedDamper(
        AddTunedMassDamper(at_dof, mass, *robust),
        AddTunedMassDamper(at_dof, mass, *nominal),
        peak_below(*robust),
        peak_below(*nominal),
        float(np.quantile(peaks(receptances[1:]), quantile)),
        quantile,
        (low, high),
        n_draws,
    )


def _dominant_mode(model: IdentifiedModel, dof: Dof, band: tuple[float, float] | None) -> tuple[float, float]:
    """Frequency, Hz, and modal mass as seen at `dof`, kg, of the mode that gives most of the flexibility there.

    Only elastic modes within `band` (Hz; None for all of the lowest 20) count. `InputError` if none of them moves `dof`.
    """
    structure = model.structure
    structure.require_modes("a tuned mass damper")
    low, high = band or (0.0, np.inf)
    n_modes = min(_MODES, structure.n_dofs)
    shapes = structure_modes(structure, model.values, n_modes)
    while shapes.frequency.max(initial=0.0) < high < np.inf and n_modes < structure.n_dofs:
        n_modes = min(2 * n_modes, structure.n_dofs)
        shapes = structure_modes(structure, model.values, n_modes)
    motion = structure.selection([dof]).T @ shapes.mode_shapes
    omega = 2 * np.pi * shapes.frequency
    elastic = (omega > _RIGID * omega.max(initial=0.0)) & (shapes.frequency >= low) & (shapes.frequency <= high)
    flexible = np.where(elastic, motion[0] ** 2 / np.where(elastic, omega, 1.0) ** 2, 0.0)
    if not flexible.max(initial=0.0) > 0:
        within = "" if band is None else f" between {low:g} and {high:g} Hz"
        raise InputError(
            f"no mode{within} moves {dof}, so that a damper there does nothing; choose another place or band"
        )
    k = int(np.argmax(flexible))
    return float(shapes.frequency[k]), float(1 / motion[0, k] ** 2)


def _couple_damper(
    receptance: ComplexArray, frequency: FloatArray, mass: float, tuned: float, ratio: float
) -> ComplexArray:
    """Receptances (..., n_lines, n_outputs, n_inputs) with a damper coupled at the first output and first input.

    H - H_od z H_di / (1 + z H_dd), where z = -w^2 m (k + i w c) / (k + i w c - w^2 m) is the force that moves the foot
    of the damper, per displacement. `receptance` is in m/N, `frequency` (n_lines,) and `tuned` are in Hz, `mass` is in
    kg, `ratio` the damping ratio.
    """
    w, rate = 2 * np.pi * frequency, 2 * np.pi * tuned
    strut = mass * (rate**2 + 2j * ratio * rate * w)
    z = (-(w**2) * mass * strut / (strut - w**2 * mass))[:, None, None]
    column, row = receptance[..., :, :1], receptance[..., :1, :]
    return np.asarray(receptance - column * (z / (1 + z * receptance[..., :1, :1])) * row)


def _search(objective: Callable[[float, float], float], start: tuple[float, float]) -> tuple[float, float]:
    """Frequency and damping ratio at the minimum of `objective`, by a simplex in their logarithms.

    `start` is a first guess of both. The frequency stays within a factor of 2 of it, the damping ratio at most 1.
    """
    first = np.log(start)

    def of_logarithms(point: FloatArray) -> float:
        far = np.abs(point[0] - first[0]) > np.log(_FARTHEST) or point[1] > np.log(_MOST_DAMPED)
        return float("inf") if far else objective(*np.exp(point))

    simplex = first + np.array([[0.0, 0.0], [0.03, 0.0], [0.0, 0.3]])
    options = {"initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-9 * objective(*start), "maxiter": 200}
    frequency, ratio = np.exp(minimize(of_logarithms, first, method="Nelder-Mead", options=options).x).tolist()
    return frequency, ratio
