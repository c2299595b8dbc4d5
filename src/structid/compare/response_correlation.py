"""Measured response functions beside a model's: FRAC of every function, FDAC of every load, resonances."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, evenly_spaced_indices
from structid.core.errors import InputError
from structid.identification.record_fit import Resonance, resonances
from structid.records import FrfRecord
from structid.similarity import fdac, frac

#: Lines of an FDAC map at most, on either axis.
_MOST_LINES = 90
#: Lines that a function needs to be told from another.
_LEAST_LINES = 3


@dataclass(frozen=True, eq=False)
class ResponsesCorrelation:
    """Measured response functions beside a model's at the same lines.

    Attributes
    ----------
    name : str
    record : FrfRecord
    model : (n_frequencies, n_outputs, n_inputs) complex array
    """

    name: str
    record: FrfRecord
    model: ComplexArray

    @cached_property
    def frac(self) -> FloatArray:
        """FRAC of each function, (n_outputs, n_inputs); NaN where the measured or the modelled one is zero at all lines."""
        x, y = self.record.values, self.model
        moving = (np.abs(x).max(axis=0) > 0) & (np.abs(y).max(axis=0) > 0)
        values = np.full(moving.shape, np.nan)
        if moving.any():
            values[moving] = frac(x[:, moving], y[:, moving])
        return values

    @cached_property
    def resonances(self) -> tuple[Resonance, ...]:
        """Resonance peaks of the record, each with the nearest peak of the model; () if the record has none."""
        return resonances(self.record, self.model)

    @cached_property
    def map_lines(self) -> np.ndarray:
        """Positions of the lines of `fdac`, at most `_MOST_LINES`, evenly spread, (n_shown,)."""
        return evenly_spaced_indices(len(self.record.frequency), _MOST_LINES)

    @cached_property
    def fdac(self) -> FloatArray | None:
        """FDAC of the measured lines (rows) with those of the model (columns), for every load, (n_inputs, n_shown, n_shown).

        None with a single output. The lines are those of `map_lines`.
        """
        if self.record.values.shape[1] < 2:
            return None
        return fdac(self.record.values[self.map_lines], self.model[self.map_lines])

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence with the measured resonances (up to six) that the model lacks, as a tuple; empty if there are none."""
        missing = [f"{resonance.measured:.5g}" for resonance in self.resonances if np.isnan(resonance.predicted)]
        if not missing:
            return ()
        return (
            f"at the lines of the record the model shows no resonance within 15 % of those measured at {', '.join(missing[:6])} Hz",
        )


def correlated_responses(record: FrfRecord, model: ComplexArray, name: str = "") -> ResponsesCorrelation:
    """Comparison of the FRFs of `record` with those of a model at the same lines.

    Parameters
    ----------
    record : FrfRecord
        Measured FRFs, of at least three lines.
    model : (n_frequencies, n_outputs, n_inputs) complex array
        FRFs of the model at the lines of the record, of the same kind.
    name : str
        Name of the record in the result.

    Raises
    ------
    InputError
        If the shapes differ, there are fewer than three lines, or the model's response is not finite.
    """
    if model.shape != record.values.shape:
        raise InputError(f"the model's response must be {record.values.shape} like the record's, got {model.shape}")
    if len(record.frequency) < _LEAST_LINES:
        raise InputError(
            f"the record has {len(record.frequency)} lines in the band, of which any two functions are alike; widen the band"
        )
    if not np.isfinite(model).all():
        raise InputError("the model's response is not finite; check its masses, stiffnesses and supports")
    return ResponsesCorrelation(name, record, model)
