"""What the reader of an identification should know first, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.estimation import Estimate, Status
from structid.identification.identified import RecordFit
from structid.identification.model_modes import rounding_warnings


def record_fit_warnings(fits: Sequence[RecordFit], prepared: Sequence[Sequence[str]]) -> list[str]:
    """What each record gives to warn of, with its name where there are several."""
    first = [f"{fit.name}: " if len(fits) > 1 else "" for fit in fits]
    warnings = [name + words for name, own in zip(first, prepared, strict=True) for words in own]
    return warnings + [
        name + words
        for name, fit in zip(first, fits, strict=True)
        for words in [*_polarity_warnings(fit), *rounding_warnings(fit.modes.rounding)]
    ]


def _polarity_warnings(fit: RecordFit) -> list[str]:
    return [
        f"{name} is -1: the channel reads with the opposite sense; correct its sign in the record or the study"
        for name, sign in fit.polarities.items()
        if sign < 0
    ]


def _scale_warnings(found: Estimate) -> list[str]:
    """Whether a gain leaves the absolute size of masses and stiffnesses open."""
    kinds = np.array(found.kinds)
    for direction in found.identifiability.directions:
        part = np.abs(direction.vector) > 0.1 * np.abs(direction.vector).max()
        gains = [name for name, taken in zip(found.names, part & (kinds == "gain"), strict=True) if taken]
        if gains and {"mass", "stiffness"} & set(kinds[part]):
            return [
                f"absolute masses and stiffnesses are not measured while {' and '.join(gains)} is unknown: the data give"
                " only their ratios, and their size rests on priors alone; a known mass or a calibrated channel fixes it"
            ]
    return []


def _several_fits(found: Estimate) -> str:
    """That other parameters fit as well, and how far off the nearest of them is."""
    best, other = [answer for answer in found.answers if answer.fits][:2]
    change = np.abs(other.values / best.values - 1)
    worst = int(np.argmax(change))
    return (
        f"{found.n_fitting} distinct parameter sets fit the data equally well, among {found.n_starts} searches: in another"
        f" one {found.names[worst]} is {other.values[worst]:.4g} instead of {best.values[worst]:.4g}; measure more lines"
        " or places, or give a prior"
    )


def estimate_warnings(found: Estimate) -> tuple[str, ...]:
    warnings = []
    if found.status is not Status.CONVERGED:
        warnings.append(f"{found.status.words} ({found.message})")
    warnings.extend(f"the data determine {direction.words}" for direction in found.identifiability.directions)
    warnings.extend(_scale_warnings(found))
    for name, identified, value, std in zip(found.names, found.identified, found.values, found.std, strict=True):
        if not identified:
            where = "at the initial values " if std <= abs(value) else ""
            warnings.append(f"{name} is not identified: {where}its standard deviation is larger than its value")
    if found.residual_tests is not None:
        chi_square = "than the stated noise"  # larger is told below, with what is done about it
        warnings.extend(w for w in found.residual_tests.words if f"larger {chi_square}" not in w)
    if found.n_fitting > 1:
        warnings.append(_several_fits(found))
    elif found.n_agreeing < found.n_starts:
        warnings.append(
            f"{found.n_agreeing} of {found.n_starts} searches ended at this minimum, the others at worse ones:"
            " there may be a better one still; start closer, or try more `restarts`"
        )
    if found.covariance_basis == "model_error":
        warnings.append(
            f"the model does not fit to within the stated errors (chi-square per degree of freedom"
            f" {found.chi_square_per_dof:.3g}, residual correlated over {found.residual_correlation:.0f} lines):"
            " standard deviations are those that carry model error"
        )
    return tuple(warnings)
