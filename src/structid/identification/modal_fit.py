"""Fit of the identified model to one record of modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray, IntArray
from structid.dynamics import Modes
from structid.forward import ModalProblem
from structid.forward.modal.output import ModelState, pairing
from structid.forward.modal.problem import shape_residual
from structid.identification.record_fit import FittedUnknowns, structure_modes
from structid.modal import ModalRecord
from structid.similarity import mac_with_model, subspace_angles

#: Standard deviations by which a frequency is far off, and shape values for each frequency from where on these outvote it.
_FAR_OFF, _OUTVOTED = 5.0, 3


@dataclass(frozen=True, eq=False)
class PairedModes:
    """The model's modes beside the measured ones, in the order of the measured.

    Attributes
    ----------
    number : (n_measured,) int array
        Which mode of the model, from 0.
    frequency, damping_ratio : (n_measured,) float arrays
        Of the model, Hz and 1.
    mac : (n_measured,) float array
    angle : (n_measured,) float array
        Largest principal angle, rad, between the measured shapes of the mode's group and the model's; of the shape
        itself for a single mode. NaN, like `mac`, of a mode without a known shape entry.
    passed_over : (n_others,) float array
        Hz: modes of the model within the measured range that no measured one is paired with, though the sensors move.
    """

    number: IntArray
    frequency: FloatArray
    damping_ratio: FloatArray
    mac: FloatArray
    angle: FloatArray
    passed_over: FloatArray


def paired_modes(problem: ModalProblem, theta: FloatArray) -> PairedModes:
    """Modes of the model paired with the measured ones of `problem`, at its free variables `theta` (n_params,).

    For each measured mode they hold the number of the model's mode (from 0), frequency (Hz), damping ratio, MAC,
    and the largest angle (rad) between measured and computed shapes of its group of close modes, NaN without
    shapes. Last come frequencies (Hz) of unpaired modes that the sensors see, from 3 % below the lowest measured to
    3 % above the highest.
    """
    state = problem.model.state(problem.physical(theta))
    number = pairing(problem.data, state, problem.in_order)
    shapes = problem.data.shapes[:, problem.data.measured]
    seen = state.seen
    position = {int(mode): i for i, mode in enumerate(problem.data.measured)}
    angle, moves = np.full(len(number), np.nan), np.abs(seen).max(axis=0, initial=0.0) > 0
    for group in problem.data.groups:
        members = np.array([position[int(mode)] for mode in group.members])
        if len(group.channels):
            x, y = shapes[np.ix_(group.channels, members)], seen[np.ix_(group.channels, number[members])]
            angle[members] = subspace_angles(x, y).max()
    f = state.modes.frequency
    measured = problem.data.frequency
    inside = (f >= 0.97 * measured.min()) & (f <= 1.03 * measured.max()) & moves
    inside[number] = False
    like = np.diag(mac_with_model(shapes, seen[:, number], moves[number]))
    return PairedModes(number, f[number], damping_ratios(state)[number], like, angle, f[inside])


def damping_ratios(state: ModelState) -> FloatArray:
    """Damping ratios of the modes in `state`, (n_modes,), without coupling of modes by damping.

    Viscous and structural damping are both included. At 0 Hz the ratio is NaN, or infinite if the mode has damping.
    """
    phi, omega = state.modes.mode_shapes, 2 * np.pi * state.modes.frequency
    with np.errstate(divide="ignore", invalid="ignore"):
        lost = np.einsum("dm,dm->m", phi, state.damping @ phi) / omega
        lost += np.einsum("dm,dm->m", phi, state.structural @ phi) / omega**2
    return 0.5 * lost


@dataclass(frozen=True, eq=False)
class ModalFit:
    """Identified modes beside one record of modes.

    Attributes
    ----------
    name : str
    problem : ModalProblem
    theta : (n_own,) float array
        Free variables of this problem's parameters at the end.
    initial_values : (n_own,) float array
        Physical values of this problem's parameters at the start.
    measured : ModalRecord
        The modes that were fitted.
    initial, fitted : PairedModes
        The model's modes beside the measured ones, before and after.
    modes_initial, modes : Modes
        Of the initial and of the identified model.
    """

    name: str
    problem: ModalProblem
    theta: FloatArray
    initial_values: FloatArray
    measured: ModalRecord
    initial: PairedModes
    fitted: PairedModes
    modes_initial: Modes
    modes: Modes

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about measured modes without a match in the model, and modes of the model that were not measured.

        A mode matches if its MAC, or the squared cosine of the angle to a group of close modes, is 0.5 or more.
        """
        warnings: list[str] = []
        f = self.problem.data.frequency
        for i, (value, like) in enumerate(zip(f.tolist(), self.fitted.mac.tolist(), strict=True)):
            likeness = like if self.problem.data.is_alone[i] else float(np.cos(self.fitted.angle[i]) ** 2)
            if likeness < 0.5:
                warnings.append(
                    f"the mode measured at {value:.5g} Hz matches no mode of the model: the nearest, at"
                    f" {self.fitted.frequency[i]:.5g} Hz, has a MAC of {likeness:.2f}; check sensors and model, or leave the"
                    " mode out with `use`"
                )
        if self.fitted.passed_over.size:
            listed = ", ".join(f"{value:.5g}" for value in self.fitted.passed_over[:5])
            warnings.append(
                f"the identified model has modes at {listed} Hz that no measured mode is paired with: they may have been"
                " missed in the test, or the model has modes that the structure has not"
            )
        return tuple(warnings)

    @property
    def is_far_off(self) -> NDArray[np.bool_]:
        """Measured modes (n_measured,) whose frequency the fitted model misses by more than five standard deviations."""
        data = self.problem.data
        return np.abs(self.fitted.frequency - data.frequency) > _FAR_OFF * data.frequency_std

    @property
    def outvoted(self) -> str:
        """Sentence with a remedy if a frequency is far off and many shape values outweigh few frequencies; else "".

        Far off is more than five standard deviations; many are three shape values or more for each frequency.
        """
        data = self.problem.data
        off = (self.fitted.frequency - data.frequency) / data.frequency_std
        worst = int(np.argmax(np.abs(off)))
        shape = shape_residual(self.problem, self.theta)
        if not self.is_far_off[worst] or len(shape) < _OUTVOTED * len(off):
            return ""
        size, of = float(np.sqrt(np.mean(shape**2))), data.frequency[worst]
        heavy = float(np.sum(shape**2) / (np.sum(shape**2) + np.sum(off**2)))
        change = 100 * (self.fitted.frequency[worst] / of - 1)
        remedy = (
            f"where the model is right, their errors are stated too small: with errors {size:.2g} times as large"
            " (`shape_error`) they would fit, and count less"
            if size > 1.5
            else "the shapes fit, so that it is the model that cannot have both: state larger errors of the frequencies"
            " (`frequency_error`) only if these are in doubt"
        )
        return (
            f"the frequency of the mode measured at {of:.5g} Hz is missed by {change:.2g} %, {abs(off[worst]):.0f} standard"
            f" deviations: {len(shape)} shape values, {size:.2g} standard deviations off on average (rms), outvote"
            f" {len(off)} frequencies and make {100 * heavy:.0f} % of the misfit; {remedy}"
        )


def modal_fit(name: str, problem: ModalProblem, own: FittedUnknowns, n_modes: int) -> ModalFit:
    """Initial and fitted model beside one record of measured modes, with the `n_modes` lowest modes of each.

    `name` is that of the record; `own` holds the free variables, values and initial values of the problem's parameters.
    """
    values = own.initial, own.values
    before, after = (structure_modes(problem.structure, problem.property_values(v), n_modes) for v in values)
    free = problem.unknowns.transforms.free(own.initial)
    initial, fitted = (paired_modes(problem, theta) for theta in (free, own.theta))
    return ModalFit(name, problem, own.theta, own.initial, problem.record, initial, fitted, before, after)
