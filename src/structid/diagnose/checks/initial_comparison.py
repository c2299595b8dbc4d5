"""Comparison of each record with its initial model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from structid.core.arrays import ComplexArray
from structid.core.errors import SingularModelError
from structid.diagnose.checks.aligned_responses import ResonancePair, aligned
from structid.diagnose.checks.channels import ChannelWarnings, channel_warnings
from structid.forward import FrfProblem, RecordProblem
from structid.forward.modal import compares_modes
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup

if TYPE_CHECKING:
    from structid.forward import ModalProblem


@dataclass(frozen=True)
class InitialComparison:
    """A record beside its initial model.

    Attributes
    ----------
    resonances : tuple of ResonancePair
    warnings : ChannelWarnings
        Senses, units and levels of channels that do not look right.
    """

    resonances: tuple[ResonancePair, ...] = ()
    warnings: ChannelWarnings = field(default_factory=ChannelWarnings)


def compare_with_initial_model(setup: AnySetup, problem: RecordProblem, options: IdentifyOptions) -> InitialComparison:
    """Resonances and channels of a record beside those of the initial model, with warnings about the channels.

    Of modes only the resonances are compared. Histories are compared as averaged FRFs if the set-up gives any; else the
    result is empty. `problem` is that of `setup`; `options` say how histories are averaged.

    Raises
    ------
    SingularModelError, InputError
        If the initial model cannot be evaluated.
    """
    if compares_modes(problem):
        return _compare_modes(problem)
    averaged = setup.shown_problem(options, problem.channels)
    if averaged is not None:
        return _compare_responses(averaged, averaged.predicted(averaged.theta_start))
    if not isinstance(problem, FrfProblem):
        return InitialComparison()
    predicted = problem.predicted(problem.theta_start)
    if not np.isfinite(predicted).all():
        raise SingularModelError(
            "the initial model's response is not finite; check its masses, stiffnesses and supports"
        )
    return _compare_responses(problem, predicted)


def _compare_responses(problem: FrfProblem, predicted: ComplexArray) -> InitialComparison:
    comparison = aligned(problem, predicted)
    return InitialComparison(comparison.pairs, channel_warnings(comparison))


def _compare_modes(problem: ModalProblem) -> InitialComparison:
    """Measured modes with those of the initial model that they are paired with, then unmatched modes of the model.

    The latter, those passed over by the pairing, have NaN for the measured frequency and the MAC.
    """
    from structid.identification.modal_fit import paired_modes  # for records of modes alone

    theta = np.asarray(problem.theta_start)
    problem.residual(theta)
    pairs = paired_modes(problem, theta)
    columns = (problem.data.frequency.tolist(), pairs.frequency.tolist(), pairs.mac.tolist())
    resonances = [ResonancePair(*row) for row in zip(*columns, strict=True)]
    extra = [ResonancePair(np.nan, frequency, np.nan) for frequency in pairs.passed_over.tolist()]
    return InitialComparison((*resonances, *extra))
