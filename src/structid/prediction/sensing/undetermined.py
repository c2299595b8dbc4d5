"""Sentences on motion and forces that a record hardly determines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import format_number, join_words
from structid.core.dof import Dof
from structid.prediction.poles import ReducedMatrices
from structid.prediction.recovery import Output
from structid.prediction.sensing.forces import ForceProcess
from structid.prediction.sensing.setup import SensingSetup
from structid.prediction.sensing.smoother import error_spectra

#: Part of the variance of a force before the record that remains, above which the record hardly determines it.
_UNSEEN = 0.9
#: Part of a combination of forces below which a force is not named in it.
_NAMED = 0.3
#: Lines at which what the sensors tell of a motion is looked at, and part of its remaining variance from lines where they tell less
#: than half of it, from which on its band rests on the spectrum of the forces.
_LOOKED_AT, _RESTING = 40, 0.3


def slow_motion_words(
    setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess, outputs: Sequence[Output], motion: str
) -> tuple[str, ...]:
    """Sentence on those of `outputs` whose bands rest on the spectrum that was estimated for the forces; () if none do.

    Bands do so where, from the lowest frequency on, more than half of the variance of the motion remains open, and this
    makes over 30 % of the variance of its error. Accelerometers hardly tell slow motion: their noise hides it. Its band
    is then that of forces whose size at low frequencies follows from a spectrum fitted to high ones. `outputs` are the
    first of the outputs of the filter; `motion` is the word for what is sensed. `reduced` is the structure on its
    modes, `process` that of each unknown force.
    """
    frequency = np.geomspace(setup.rate / len(setup.driving), setup.rate / 2, _LOOKED_AT)
    tables = error_spectra(setup, reduced, process, frequency)
    total, left = (table[:, : len(outputs)] * frequency[:, None] for table in tables)
    slow = np.logical_and.accumulate(left > total / 2)  # from the lowest line on, without gaps
    whole = left.sum(axis=0)
    part = np.divide((left * slow).sum(axis=0), whole, out=np.zeros(len(outputs)), where=whole > 0)
    resting = np.flatnonzero(part > _RESTING)
    if not len(resting):
        return ()
    limits = [format_number(float(frequency[n - 1]), 2) for n in sorted(slow[:, resting].sum(axis=0).tolist())]
    parts = [f"{100 * each:.0f}" for each in sorted(part[resting].tolist())]
    below, percent = (" to ".join(dict.fromkeys((words[0], words[-1]))) for words in (limits, parts))
    names = [f"the {motion} at {each}" if isinstance(each, Dof) else str(each) for each in outputs]
    return (
        f"below {below} Hz these sensors tell less than half of {join_words([names[i] for i in resting], 3)}, and {percent} % of"
        " the variance of the error comes from there: such a band rests on the spectrum that is taken for the unknown forces, and"
        " is far too narrow if they have more slow parts, as under vehicles that cross; measure a displacement or an inclination"
        " too",
    )


def undetermined_force_words(forces: Sequence[Dof], covariance: FloatArray, std: float) -> tuple[str, ...]:
    """Sentences on forces, and combinations of them, that the record hardly determines; () if there are none.

    Hardly means that more than 90 % of the variance remains. `covariance` (n_forces, n_forces) is that of the forces after the
    record, `std` the deviation of each before it, N.
    """
    if not forces:
        return ()
    remaining = covariance / std**2
    blind = [dof for dof, part in zip(forces, np.diag(remaining), strict=True) if part > _UNSEEN]
    words = [f"the record hardly determines the force at {join_words(blind)}: no sensor moves with it"] if blind else []
    parts, directions = np.linalg.eigh(remaining)
    for part, direction in zip(parts, directions.T, strict=True):
        largest = float(direction[np.argmax(np.abs(direction))])
        named = [(weight / largest, dof) for weight, dof in zip(direction.tolist(), forces, strict=True)]
        named = [(weight, dof) for weight, dof in named if abs(weight) > _NAMED]
        if part > _UNSEEN and len(named) > 1 and not all(dof in blind for _, dof in named):
            text = " ".join(f"{'-' if weight < 0 else '+'} {abs(weight):.2g} {dof.place}" for weight, dof in named)
            words.append(
                f"the record hardly determines the forces {text.removeprefix('+ ')} together: their sum moves no sensor"
            )
    return tuple(words)


def distributed_force_words(n_forces: int, n_sensors: int) -> str:
    """A sentence on more unknown forces than sensors."""
    return (
        f"{n_forces} unknown forces act and {n_sensors} sensors measure: the record tells what they do to the motion, hardly each"
        " of them; a wrong model and forces of another spectrum look the same"
    )
