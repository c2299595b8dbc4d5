"""`structid predict`: FRFs, histories and modes of a results folder, before and after changes, with bands; and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.constraints import split_commas
from structid.core.display import join_words, span_text
from structid.core.dof import Dof, parse_dof, parse_dofs
from structid.core.errors import InputError
from structid.core.isolation import absolute_paths
from structid.core.json_types import StoredEntry
from structid.core.units import FrfKind
from structid.fem import Base, Structure
from structid.files import csv_text
from structid.prediction.changes import Change, changed_model
from structid.prediction.identified_model import IdentifiedModel
from structid.prediction.linear_response import Input, is_support, support_base
from structid.prediction.loads import coloured_noise, half_sine, read_density, sine
from structid.prediction.options import PredictOptions
from structid.prediction.participation import ModalParticipation
from structid.prediction.predict import PredictedChange, Prediction, predict_changes, predict_together
from structid.prediction.quantities import (
    Extremes,
    Frf,
    History,
    Maxima,
    NaturalModes,
    Quantity,
    RootMeanSquare,
    Spectrum,
    support_acceleration,
)
from structid.prediction.recovery import Output, distinct_channels, is_von_mises, parse_outputs
from structid.prediction.tuned_damper import TunedDamper, tune_damper
from structid.records import ReadOptions, TimeRecord, read_record
from structid.study.results.stored_model import (
    stored_band,
    stored_doubt,
    stored_loads,
    stored_model,
    stored_model_error,
    stored_study,
)
from structid.study.schema.study import Study
from structid.unknowns import Parameters

PREDICTION_PAGE = "prediction.html"
PredictionOrChange: TypeAlias = Prediction | PredictedChange | None
#: Probabilities at which the distribution of a maximum is written.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95, 0.99)


@dataclass(frozen=True, eq=False)
class StudyPrediction:
    """Predictions from a results folder; `PredictedChange` where there are changes.

    Attributes
    ----------
    folder : Path
        The results that it is made from.
    title : str
    modes : Prediction or PredictedChange
    frf, history, maxima : the same or None
    changes : tuple of str
        In words.
    spectrum, root_mean_square, largest : the same or None
        Under stationary noise; the largest within `duration` on the mean.
    duration : float, optional
        s.
    loads : str
        What acts in `history` and `spectrum`, in words.
    damper : TunedDamper, optional
        The damper that was tuned, one of the changes.
    doubt : str
        Why the model behind it is not to be trusted; "" where it is.
    participation : dict of str to Prediction or PredictedChange
        Of the modes, by the axis along which the ground moves.
    """

    folder: Path
    title: str
    modes: Prediction | PredictedChange
    frf: Prediction | PredictedChange | None
    history: Prediction | PredictedChange | None
    maxima: Prediction | PredictedChange | None
    changes: tuple[str, ...]
    spectrum: Prediction | PredictedChange | None = None
    root_mean_square: Prediction | PredictedChange | None = None
    largest: Prediction | PredictedChange | None = None
    duration: float | None = None
    loads: str = ""
    damper: TunedDamper | None = None
    doubt: str = ""
    participation: dict[str, Prediction | PredictedChange] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """Sentence on which uncertainties the bands include."""
        shown = self.frf or self.modes
        return shown.before.words if isinstance(shown, PredictedChange) else shown.words


def predict_study(
    folder: Path, options: PredictOptions, changes: Sequence[Change] = (), study: Path | None = None
) -> StudyPrediction:
    """Predictions from a results folder of `structid identify`.

    Parameters
    ----------
    folder : Path
        Results folder.
    options : PredictOptions
        Sensors, loads, band and number of draws.
    changes : sequence of Change, optional
        Changes of the structure; with any, each quantity is predicted before and after them.
    study : Path, optional
        The study file, if it was moved since.

    Raises
    ------
    InputError
        If the folder, its study, a place or a change cannot be used.
    NoAnswerError
        If the data do not determine the model.
    """
    return predict_stored(stored_study(folder, study), folder, options, changes)


def predict_stored(
    source: Study, folder: Path, options: PredictOptions, changes: Sequence[Change] = ()
) -> StudyPrediction:
    """Predictions from the results folder `folder` of the study `source`, which has been read, after `changes`.

    Modes are always predicted. FRFs need sensors and loads; histories and maxima need a load over time, or a noise with
    a sampling rate; spectra need a noise with a duration. Predictions that were not asked for are None.

    Raises
    ------
    InputError
        If an option cannot be used with the others or with this model.
    FileError
        If a file of the folder or of the loads is missing, damaged or of another version.
    NoAnswerError
        If the data do not determine the model.
    """
    model = stored_model(folder, source)
    structure, parameters = changed_model(model.structure, model.parameters, changes)
    axes = split_commas(options.participation)
    _require_moving_mass(axes, model, [(model.structure, model.parameters), (structure, parameters)])
    damper = None
    if options.tune_damper:
        damper = _damper(replace(model, structure=structure, parameters=parameters), options)
        changes = [*changes, damper.change]
    outputs = parse_outputs(split_commas(options.sensors))
    if outputs:
        distinct_channels("sensors", outputs)
    loaded = next((name for name in ("history", "half_sine", "sine", "noise") if getattr(options, name)), None)
    if loaded is not None and not outputs:
        raise InputError(f"`sensors` must name where the motion under `{loaded}` is wanted, got none", "sensors")
    several = partial(predict_changes, model, changes=changes) if changes else partial(predict_together, model)

    error = stored_model_error(folder, source) if outputs else None

    def of(*quantities: Quantity) -> list[Prediction] | list[PredictedChange]:
        return several(quantities, n_draws=options.draws, seed=options.seed, model_error=error)

    frf: PredictionOrChange = None
    history: PredictionOrChange = None
    maxima: PredictionOrChange = None
    spectrum: PredictionOrChange = None
    mean: PredictionOrChange = None
    largest: PredictionOrChange = None
    band = options.band or _predicted_band(folder, source)
    words: list[str] = []
    if outputs:
        linear = tuple(output for output in outputs if not is_von_mises(output))
        names = split_commas(options.loads) or stored_loads(folder, is_needed=loaded is None)
        if linear and names:
            inputs = _inputs(model.structure, names, options)
            quantity = Frf(linear, inputs, _frequency_lines(band, options), kind_under(inputs, options.kind))
            [frf] = of(quantity)
        elif not linear and loaded is None:
            raise InputError(
                "a von Mises stress has no FRF, since it is not linear in the load; give `history`, `half_sine`, `sine` or `noise`",
                "sensors",
            )
    if loaded in ("history", "half_sine", "sine"):
        pushed, sentence = _history(model.structure, outputs, options)
        history, maxima = of(pushed, Maxima(pushed))
        words.append(sentence)
    if options.noise and options.duration is not None:
        density = _spectrum(model.structure, outputs, _frequency_lines(band, options), options)
        if any(is_von_mises(output) for output in outputs):
            spectrum, mean = of(density, RootMeanSquare(density))
        else:
            spectrum, mean, largest = of(density, RootMeanSquare(density), Extremes(density, options.duration))
        words.append(f"noise of {options.noise}")
        if options.sampling_rate is not None and loaded == "noise":
            pushed = _noise_history(model.structure, outputs, options.duration, options.sampling_rate, options)
            history, maxima = of(pushed, Maxima(pushed))
            words.append(f"history and maxima under one sample of it (seed {options.seed})")
    change_words = tuple(change.words for change in changes)
    modes, *shares = of(NaturalModes(options.modes), *(ModalParticipation(axis, options.modes) for axis in axes))
    return StudyPrediction(
        folder,
        source.title,
        modes,
        frf,
        history,
        maxima,
        change_words,
        spectrum,
        mean,
        largest,
        options.duration,
        "; ".join(words),
        damper,
        stored_doubt(folder),
        dict(zip(axes, shares, strict=True)),
    )


def _require_moving_mass(
    axes: Sequence[str], model: IdentifiedModel, structures: Sequence[tuple[Structure, Parameters]]
) -> None:
    """Raise `InputError` for the first of `axes` along which no mass of one of `structures` moves.

    `structures` are pairs of a structure and its parameters. All structures are checked at the identified values of
    `model`; without axes nothing is checked.
    """
    for structure, parameters in structures if axes else ():
        structure.require_modes("modes")
        for axis in axes:
            evaluate = ModalParticipation(axis, 1).evaluator(structure, parameters, [model.physical])
            try:
                evaluate(model.physical)
            except InputError as error:
                raise InputError(f"`participation` {axis}: {error}", "participation") from error


def _damper(model: IdentifiedModel, options: PredictOptions) -> TunedDamper:
    """The tuned mass damper that the option ``tune_damper`` asks for, tuned to the model.

    The option reads ``mass@dof`` with the mass in kg, such as ``800@40X``; else `InputError`.
    """
    mass, at, dof = options.tune_damper.partition("@")
    try:
        kg = float(mass)
    except ValueError:
        at = ""
    if not at:
        raise InputError(
            f"`tune_damper` must be a mass in kg and a place, as 800@40X, got {options.tune_damper!r}", "tune_damper"
        )
    return tune_damper(model, dof, kg, band=options.band, seed=options.seed)


def _predicted_band(folder: Path, study: Study) -> tuple[float | None, float | None]:
    """Lower and upper end of the band of predictions, Hz; an end is None if it is not known.

    It is the band that the study states, else that of the fitted FRFs.
    """
    low, high = study.options.band or (None, None)
    lowest, highest = stored_band(folder) or (None, None)
    return lowest if low is None else low, highest if high is None else high


def _frequency_lines(band: tuple[float | None, float | None], options: PredictOptions) -> FloatArray:
    """Equally spaced frequencies (Hz) of FRFs and spectra, as many as the options say, from end to end of `band`.

    `InputError` if an end of the band is None. The result is (n_frequencies,).
    """
    low, high = band
    if low is None or high is None:
        raise InputError(
            "`band` must be given (--band LOW HIGH): neither the study, under [method], nor a record of FRFs states one",
            "band",
        )
    return np.linspace(low, high, options.lines)


def kind_under(inputs: Sequence[Input], kind: FrfKind) -> FrfKind:
    """The kind of the FRFs under these inputs: `kind`, or transmissibility where all inputs are moving supports.

    Raises
    ------
    InputError
        If all inputs are moving supports and `kind` is receptance or mobility; accelerance, the default, is replaced.
    """
    moved = [dof for each in inputs if isinstance(each, Base) for dof in each.supports]
    if not all(isinstance(each, Base) for each in inputs):
        return kind
    if kind in ("receptance", "mobility"):
        raise InputError(
            f"`kind` must be transmissibility where a support moves, as {moved[0]} does, got {kind}; leave it out, or name loads"
            " that are no supports",
            "kind",
        )
    return "transmissibility"


def _inputs(structure: Structure, names: Sequence[str | Dof], options: PredictOptions) -> tuple[Input, ...]:
    """Loads in the order of their `names`: a degree of freedom, or, for a support, the base that moves with it."""
    return tuple(_input(structure, dof, options.supports == "together") for dof in parse_dofs(names))


def _input(structure: Structure, dof: Dof, together: bool) -> Input:
    """The degree of freedom `dof` as an input: a force or, at a support, the base that moves with it.

    With `together` all supports of that direction move.
    """
    return support_base(structure, dof, together) if is_support(structure, dof) else dof


def _history(structure: Structure, outputs: tuple[Output, ...], options: PredictOptions) -> tuple[History, str]:
    """The quantity that predicts the motion under the loads of the options, and a text that describes these loads.

    The loads are those of a recorded file, a half-sine or a sine.
    """
    if options.history is not None:
        recorded = _recorded_loads(structure, options.history, options)
        inputs, loads, rate = recorded.inputs, recorded.loads, recorded.sampling_rate
        is_filtered = tuple(options.filtered and not is_way for is_way in recorded.is_displacement)
        words = f"loads of {options.history.name}, {_between_samples(recorded, options.filtered)}"
    else:
        is_filtered = (False,)
        name = "half_sine" if options.half_sine else "sine"
        second_name = "width" if options.half_sine else "frequency"
        (size, second), dof = _sizes_at(name, options.half_sine or options.sine, ("size", second_name))
        duration, rate = options.duration or 0.0, options.sampling_rate or 0.0
        make = half_sine if options.half_sine else sine
        inputs, loads = (
            (_input(structure, dof, options.supports == "together"),),
            make(size, second, duration, rate)[:, None],
        )
        unit = ("N m" if dof.is_rotation else "N") if isinstance(inputs[0], Dof) else "m/s^2"
        what = f"half-sine of {second:g} s" if options.half_sine else f"sine of {second:g} Hz"
        words = f"{what}, {size:g} {unit}, at {dof}"
    for base in inputs:
        if isinstance(base, Base):
            several = len(base.supports) > 1
            words += f"; {join_words(base.supports)} {'move together' if several else 'moves'}"
    return History(outputs, inputs, loads, rate, options.motion, options.relative, is_filtered), words


@dataclass(frozen=True, eq=False)
class _RecordedLoads:
    """Loads of a record of time histories.

    Attributes
    ----------
    inputs : tuple of Dof or Base
    loads : (n_times, n_inputs) float array
        N, N m, or m/s^2 of supports.
    sampling_rate : float
        Hz.
    is_displacement : tuple of bool
        For each input, whether the file states the displacement of a support.
    """

    inputs: tuple[Input, ...]
    loads: FloatArray
    sampling_rate: float
    is_displacement: tuple[bool, ...]


def _between_samples(recorded: _RecordedLoads, is_filtered: bool) -> str:
    """Words on how recorded loads run between their samples: band-limited if `is_filtered` against aliasing, else straight.

    Displacements of supports follow a spline.
    """
    words = "band-limited between samples" if is_filtered else "in straight lines between samples"
    if not any(recorded.is_displacement):
        return words
    spline = "displacements of supports along a cubic spline through the samples"
    return spline if all(recorded.is_displacement) else f"{spline}, all others {words}"


def _recorded_loads(structure: Structure, path: Path, options: PredictOptions) -> _RecordedLoads:
    """Loads of the record of time histories at `path`.

    Channels of force are loads in N or N m; channels at supports become accelerations of these supports. Others are
    ignored. `InputError` if the file holds FRFs or no load, gives the velocity of a support, moves a support twice, or
    has displacements alone though the options say that it is ``filtered``.
    """
    record = read_record(path, ReadOptions())
    if not isinstance(record, TimeRecord):
        raise InputError(f"{path}: holds FRFs; `history` takes loads over time", "history")
    inputs: list[Input] = []
    loads: list[FloatArray] = []
    is_displacement: list[bool] = []
    displaced: list[Dof] = []
    for dof, quantity, column in zip(record.channels, record.quantities, record.values.T, strict=True):
        if quantity == "force":
            inputs.append(dof)
            loads.append(column)
            is_displacement.append(False)
        elif is_support(structure, dof):
            if quantity == "velocity":
                raise InputError(
                    f"{path}: {dof} is a velocity; a support moves by its acceleration or displacement", "history"
                )
            inputs.append(support_base(structure, dof, options.supports == "together"))
            is_way = quantity == "displacement"
            is_displacement.append(is_way)
            displaced += [dof] if is_way else []
            loads.append(support_acceleration(column[:, None], record.sampling_rate)[:, 0] if is_way else column)
    if not inputs:
        raise InputError(
            f"{path}: holds neither a force (a channel in N or N m) nor the acceleration or displacement of a support",
            "history",
        )
    if options.filtered and len(displaced) == len(inputs):
        raise InputError(
            f"{path}: {join_words(displaced)} {'is a displacement' if len(displaced) == 1 else 'are displacements'}, which a"
            " spline joins between samples already; leave `filtered` out",
            "filtered",
        )
    moved = [dof.unsigned for base in inputs if isinstance(base, Base) for dof in base.supports]
    if len(set(moved)) < len(moved):
        raise InputError(
            f"{path}: two channels move the same supports; leave one out, or let each move alone with supports = 'alone'",
            "supports",
        )
    return _RecordedLoads(tuple(inputs), np.column_stack(loads), record.sampling_rate, tuple(is_displacement))


def _spectrum(
    structure: Structure, outputs: tuple[Output, ...], lines: FloatArray, options: PredictOptions
) -> Spectrum:
    """Quantity that predicts the spectra of `outputs` at the frequencies `lines` (Hz) under the noise of the options.

    The spectral density of the noise is interpolated linearly and 0 outside its table; `InputError` if it is 0 at all
    lines. Under moving supports the FRFs are transmissibilities.
    """
    path, (frequency, density), loaded = _noise_parts(structure, options)
    kind = "transmissibility" if isinstance(loaded, Base) else options.kind
    within = np.interp(lines, frequency, density, left=0.0, right=0.0)
    if not within.any():
        raise InputError(
            f"{path}: has nothing between {lines[0]:g} and {lines[-1]:g} Hz, the band; give another with `band`",
            "noise",
        )
    return Spectrum(Frf(outputs, (loaded,), lines, kind), within[:, None])


def _noise_history(
    structure: Structure, outputs: tuple[Output, ...], duration: float, sampling_rate: float, options: PredictOptions
) -> History:
    """The quantity that predicts the motion of `outputs` under one random sample of the noise named in the options.

    `duration` is in s, `sampling_rate` in Hz; the seed of the options fixes the sample.
    """
    _, density, loaded = _noise_parts(structure, options)
    rng = np.random.default_rng(options.seed)
    noise = coloured_noise(*density, duration, sampling_rate, rng)
    return History(outputs, (loaded,), noise[:, None], sampling_rate, options.motion, options.relative)


def _noise_parts(structure: Structure, options: PredictOptions) -> tuple[Path, tuple[FloatArray, FloatArray], Input]:
    """Path of a noise table, its (frequencies, densities), and the driven input, by the option `noise`: ``table@dof``.

    Frequencies are in Hz, densities one-sided in N^2/Hz, or (m/s^2)^2/Hz where the input moves supports; both are
    (n_frequencies,). `InputError` if the option has no table or no degree of freedom, or the table cannot be read.
    """
    text, at, name = options.noise.rpartition("@")
    if not at or not text:
        raise InputError(f"`noise` must be a table and a place, as wind.csv@12Y, got {options.noise!r}", "noise")
    path, loaded = absolute_paths(Path(text)), _inputs(structure, [name], options)[0]
    return path, read_density(path, isinstance(loaded, Base)), loaded


def _sizes_at(name: str, text: str, parts: tuple[str, str]) -> tuple[tuple[float, float], Dof]:
    """Two numbers and a degree of freedom from the text of the option `name`, such as ``500,0.01@12Y``; else `InputError`.

    `parts` are the names of the two numbers for the error message.
    """
    sizes, at, dof = text.partition("@")
    try:
        first, second = (float(part) for part in sizes.split(","))
    except ValueError:
        at = ""
    if not at:
        raise InputError(f"`{name}` must be {parts[0]}, {parts[1]} and a place, as 500,0.01@12Y, got {text!r}", name)
    return (first, second), parse_dof(dof)


def prediction_summary(prediction: StudyPrediction) -> dict[str, StoredEntry]:
    """The content of prediction.json.

    The keys are ``title``, ``results``, ``changes``, ``bands``, ``warnings``, ``level``, ``modes``, and, where they were asked for,
    ``participation``, ``loads``, ``tuned_damper``, ``maxima``, ``root_mean_square``, ``largest`` and ``duration_s``.
    """
    modes = parts_of(prediction.modes)
    return {
        "title": prediction.title,
        "results": prediction.folder.as_posix(),
        "changes": list(prediction.changes),
        "bands": prediction.words,
        "warnings": [prediction.doubt] if prediction.doubt else [],
        "level": 0.95,
        "modes": [
            {
                "frequency_hz": {name: _value(part, (k, 0)) for name, part in modes.items()},
                "damping_ratio": {name: _value(part, (k, 1)) for name, part in modes.items()},
            }
            for k in range(len(next(iter(modes.values())).values))
        ],
        **({"participation": _participation_entry(prediction)} if prediction.participation else {}),
        **({"loads": prediction.loads} if prediction.loads else {}),
        **({} if prediction.damper is None else {"tuned_damper": _damper_entry(prediction.damper)}),
        **({} if prediction.maxima is None else {"maxima": _output_entries(parts_of(prediction.maxima))}),
        **(
            {}
            if prediction.root_mean_square is None
            else {"root_mean_square": _output_entries(parts_of(prediction.root_mean_square))}
        ),
        **(
            {}
            if prediction.largest is None
            else {"largest": _output_entries(parts_of(prediction.largest)), "duration_s": prediction.duration}
        ),
    }


def _participation_entry(prediction: StudyPrediction) -> dict[str, StoredEntry]:
    """Participation factor, effective mass and its part of the moving mass of every mode, by the axis of the ground's motion."""
    names = ("factor_kg05", "effective_mass_kg", "part_of_mass")
    return {
        axis: [
            {
                name: {label: _value(part, (k, i)) for label, part in parts_of(found).items()}
                for i, name in enumerate(names)
            }
            for k in range(len(next(iter(parts_of(found).values())).values))
        ]
        for axis, found in prediction.participation.items()
    }


def _damper_entry(damper: TunedDamper) -> dict[str, StoredEntry]:
    """The entry of a tuned damper: its values, and the largest receptances with and without it."""
    return {
        "mass_kg": damper.change.mass,
        "frequency_hz": damper.change.frequency,
        "damping_ratio": damper.change.damping_ratio,
        "largest_receptance": damper.peak,
        "largest_receptance_before": damper.peak_before,
        "quantile": damper.quantile,
        "best_for_identified_model": {
            "frequency_hz": damper.nominal.frequency,
            "damping_ratio": damper.nominal.damping_ratio,
            "largest_receptance": damper.nominal_peak,
        },
        "band_hz": list(damper.band),
        "models": damper.n_draws,
    }


def _output_entries(parts: dict[str, Prediction]) -> list[dict[str, StoredEntry]]:
    """Value, interval and quantiles of each output of a quantity without a time axis, by the names of `parts`."""
    quantity = next(iter(parts.values())).quantity
    return [
        {
            "output": str(output),
            "unit": unit,
            **{name: {**_value(part, (i,)), "quantiles": _quantiles(part, i)} for name, part in parts.items()},
        }
        for i, (output, unit) in enumerate(zip(quantity.axes["output"], quantity.units, strict=True))
    ]


def _quantiles(part: Prediction, index: int) -> dict[str, StoredEntry]:
    """Quantiles of the output `index` over the random models, by probability as text; {} if no draws are kept."""
    if part.draws is None:
        return {}
    return {f"{p:g}": float(np.quantile(part.draws[:, index].real, p)) for p in QUANTILES}


def parts_of(prediction: Prediction | PredictedChange) -> dict[str, Prediction]:
    """The predictions by their names in files: ``value``, or ``before``, ``after`` and ``difference`` if there are changes."""
    if isinstance(prediction, PredictedChange):
        return {"before": prediction.before, "after": prediction.after, "difference": prediction.difference}
    return {"value": prediction}


def _value(part: Prediction, index: tuple[int, ...]) -> dict[str, StoredEntry]:
    low, high = float(part.low[index]), float(part.high[index])
    return {
        "value": float(np.real(part.values[index])),
        "std": float(part.std[index]),
        "interval_95": [low, high],
        "interval_text": span_text(low, high),
    }


def prediction_csv(prediction: Prediction | PredictedChange) -> str:
    """CSV text of one predicted quantity, a row for each frequency or time: the axis (Hz or s), then the channels.

    These are the value and the ends of its 95 % band (low, high); FRFs have real part, imaginary part and magnitude as
    values. With changes of the structure, all columns come for before, after and the difference.
    """
    parts = parts_of(prediction)
    first = next(iter(parts.values()))
    axis, *channels = first.quantity.axes.items()
    outputs, units = channels[0][1], first.quantity.units
    inputs = channels[1][1] if len(channels) > 1 else None
    names = [f"{a}/{b}" for a in outputs for b in inputs] if inputs is not None else list(outputs)
    units = tuple(unit for unit in units for _ in (inputs if inputs is not None else ("",)))
    header, columns = [f"{axis[0]} ({'Hz' if axis[0] == 'frequency' else 's'})"], [np.asarray(axis[1], dtype=float)]
    for label, part in parts.items():
        before = "" if label == "value" else f"{label} "
        tables = {"low": part.low, "high": part.high}
        if np.iscomplexobj(part.values):
            tables = {
                "real": part.values.real,
                "imaginary": part.values.imag,
                "magnitude": np.abs(part.values),
                **tables,
            }
        else:
            tables = {"value": part.values.real, **tables}
        for what, table in tables.items():
            flat = table.reshape(len(columns[0]), -1)
            header += [f"{before}{name} {what} ({unit})" for name, unit in zip(names, units, strict=True)]
            columns += list(flat.T)
    return csv_text(header, ([f"{value:.9g}" for value in row] for row in np.column_stack(columns).tolist()))
