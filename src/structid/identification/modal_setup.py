"""Measured modes as a record of a study: how they are fitted, and what the fit shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from structid.arrays import FloatArray, IntArray
from structid.declared import NotNegative, Positive
from structid.dynamics import Modes
from structid.errors import InputError
from structid.identification.model_modes import structure_modes
from structid.modal import ModalRecord
from structid.observation import ModalForm, ModalProblem
from structid.similarity import mac, subspace_angles
from structid.structure import Structure
from structid.unknowns import Parameters


@dataclass(frozen=True)
class ModalSettings:
    """How measured modes are fitted; the fields are those of `ModalProblem`."""

    form: ModalForm = "output"
    frequency_error: NotNegative = 0.0
    damping_error: NotNegative = 0.0
    shape_error: NotNegative = 0.0
    use_damping: bool = False
    closeness: NotNegative = 0.02
    frequency_guard: Positive = 0.3


@dataclass(frozen=True, eq=False)
class ModalSetup:
    """Measured modes and what they were measured on.

    Parameters
    ----------
    structure : Structure
        As it was for these modes.
    parameters : Parameters
        Those of this structure; names shared with other set-ups are the same unknowns.
    record : ModalRecord
        With its covariance, which the parameters inherit.
    settings : ModalSettings
    name : str
        What reports call it.
    """

    structure: Structure
    parameters: Parameters
    record: ModalRecord
    settings: ModalSettings = ModalSettings()
    name: str = ""

    @property
    def time(self) -> None:
        """No histories are fitted."""
        return None

    def problem(self) -> ModalProblem:
        """The least-squares problem of these modes."""
        return ModalProblem(self.structure, self.parameters, self.record, **asdict(self.settings))


def chosen_modes(record: ModalRecord, numbers: Sequence[int]) -> ModalRecord:
    """The modes of these numbers, counted from 1 as reports count them; all for an empty list.

    Raises
    ------
    InputError
        If a number is none of a mode, or is given twice.
    """
    if not numbers:
        return record
    if len(set(numbers)) < len(numbers) or not set(numbers) <= set(range(1, record.n_modes + 1)):
        raise InputError(f"must be different numbers from 1 to {record.n_modes}, got {list(numbers)}")
    return record.some_modes(np.asarray(numbers) - 1)


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
        itself for a single mode.
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
    """The pairs of `problem` at the free variables `theta`."""
    state = problem.model_state(problem.physical(theta))
    number = problem.pairing(state.modes)
    shapes = problem.shapes[:, problem.measured]
    seen = state.sensors.T @ state.modes.mode_shapes
    position = {int(mode): i for i, mode in enumerate(problem.measured)}
    angle = np.zeros(len(number))
    for group in problem.groups:
        own = np.array([position[int(mode)] for mode in group.members])
        angle[own] = subspace_angles(shapes[:, own], seen[:, number[own]]).max()
    f = state.modes.frequency
    phi = state.modes.mode_shapes[:, number]
    omega = 2 * np.pi * f[number]
    lost = np.einsum("dm,dm->m", phi, state.damping @ phi) / omega
    lost += np.einsum("dm,dm->m", phi, state.structural @ phi) / omega**2
    measured = problem.record.frequency[problem.measured]
    inside = (f >= 0.97 * measured.min()) & (f <= 1.03 * measured.max()) & (np.abs(seen).max(axis=0) > 0)
    inside[number] = False
    return PairedModes(number, f[number], 0.5 * lost, np.diag(mac(shapes, seen[:, number])), angle, f[inside])


@dataclass(frozen=True, eq=False)
class ModalFit:
    """What was identified, seen from one record of modes.

    Attributes
    ----------
    name : str
    problem : ModalProblem
    theta : (n_own,) float array
        Free variables of this problem's parameters at the end.
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
    measured: ModalRecord
    initial: PairedModes
    fitted: PairedModes
    modes_initial: Modes
    modes: Modes


def modal_fit(
    name: str, problem: ModalProblem, theta: FloatArray, values: tuple[FloatArray, FloatArray], n_modes: int
) -> ModalFit:
    """The answer seen from one record of modes, with physical `values` before and after."""
    before, after = values
    initial = problem.parameters.transforms.free(before)
    models = [structure_modes(problem.structure, problem.parameters.values(v), n_modes) for v in (before, after)]
    pairs = paired_modes(problem, initial), paired_modes(problem, theta)
    return ModalFit(name, problem, theta, problem.record, *pairs, *models)


def modal_fit_warnings(fit: ModalFit) -> list[str]:
    """What the record says of its modes, and pairs that are no pairs."""
    warnings = list(fit.measured.warnings)
    f = fit.problem.record.frequency[fit.problem.measured]
    for i, (value, like) in enumerate(zip(f.tolist(), fit.fitted.mac.tolist(), strict=True)):
        grouped = any(len(g.members) > 1 and fit.problem.measured[i] in g.members for g in fit.problem.groups)
        likeness = float(np.cos(fit.fitted.angle[i]) ** 2) if grouped else like
        if likeness < 0.5:
            warnings.append(
                f"the mode measured at {value:.5g} Hz has no like in the model: the nearest, at"
                f" {fit.fitted.frequency[i]:.5g} Hz, has a MAC of {likeness:.2f}; check sensors and model, or leave the"
                " mode out with `use`"
            )
    if fit.fitted.passed_over.size:
        listed = ", ".join(f"{value:.5g}" for value in fit.fitted.passed_over[:5])
        warnings.append(
            f"the identified model has modes at {listed} Hz that no measured mode is paired with: they may have been"
            " missed in the test, or the model has modes that the structure has not"
        )
    return warnings
