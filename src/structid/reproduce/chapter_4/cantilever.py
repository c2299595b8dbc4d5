"""The cantilever of chapter 4: Table 4.1, the measurements that can be read into it, and the classical iteration.

References
----------
Norris (1986), chapter 4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import parse_dofs
from structid.core.errors import SingularModelError
from structid.fem import Beam, Structure
from structid.forward import FrfProblem, one_step_values
from structid.forward.frf.response import response
from structid.records import FrfRecord
from structid.unknowns import Parameters, Unknown
from structid.unknowns.parameters import parameters

N_ELEMENTS = 6
TIP = f"{N_ELEMENTS}Y+"
#: Names of the parameters in the order of Table 4.1.
SYMBOLS = tuple(f"{letter}_{j}" for letter in "mk" for j in range(1, N_ELEMENTS + 1))
#: Beyond this RMS error an iteration counts as diverged and is not followed.
DIVERGED = 1e12
#: Below this RMS error the parameters are the actual ones but for rounding.
CONVERGED = 1e-12
_UNKNOWNS = tuple(Unknown(p, "beam", each=True, positive=False) for p in ("mass", "bending_stiffness"))


@dataclass(frozen=True, eq=False)
class Case:
    """One pair of columns of Table 4.1: masses per length (kg/m), then stiffnesses EI / h^3 (N/m).

    With elements of h = 1 m the stiffnesses are the values of EI in N m^2.

    Attributes
    ----------
    name : str
    actual, postulated : (12,) float arrays
    """

    name: str
    actual: FloatArray
    postulated: FloatArray

    @property
    def relative_error(self) -> FloatArray:
        """Error of the postulated parameters, in parts of the actual ones."""
        return self.postulated / self.actual - 1

    @property
    def error_of_actual(self) -> FloatArray:
        """Actual less postulated parameters, relative to the postulated ones."""
        return self.actual / self.postulated - 1


CASE_1 = Case(
    "Case 1",
    np.array([0.92, 1.28, 1.17, 0.63, 1.11, 0.98, 1.38, 0.68, 1.24, 0.56, 0.76, 1.12]),
    np.array([0.90, 1.15, 1.20, 0.50, 1.20, 0.90, 1.30, 0.60, 1.10, 0.50, 0.90, 1.20]),
)
CASE_2 = Case(
    "Case 2",
    np.array([0.8990, 1.0520, 1.1490, 0.4520, 1.0040, 0.9010, 1.0420, 0.7480, 1.1980, 0.5520, 1.1010, 0.9010]),
    np.array([0.8600, 1.0100, 1.1300, 0.4400, 0.9800, 0.9000, 1.0000, 0.7100, 1.1700, 0.5400, 1.0800, 0.9000]),
)


@dataclass(frozen=True)
class Reading:
    """Measurement as one reading of the text has it.

    Attributes
    ----------
    label : str
    frequency : tuple of float
        Of excitation, Hz.
    outputs : tuple of str
        Sensors; the load is transverse at the tip.
    """

    label: str
    frequency: tuple[float, ...]
    outputs: tuple[str, ...]


def in_rad_per_s(*omega: float) -> tuple[float, ...]:
    """Frequencies in Hz, as a tuple, of the circular frequencies `omega` in rad/s."""
    return tuple(float(value / (2 * np.pi)) for value in omega)


GRID = tuple(0.5 * e for e in range(1, 13))
ALL_MOTIONS = tuple(f"{node}{direction}" for node in range(1, N_ELEMENTS + 1) for direction in ("Y+", "RZ+"))
DEFLECTIONS = tuple(f"{node}Y+" for node in range(1, N_ELEMENTS + 1))
ALL_AT_HALF = Reading("all 12 motions, 0.5 rad/s", in_rad_per_s(GRID[0]), ALL_MOTIONS)
ALL_AT_ALL = Reading("all 12 motions, 0.5 to 6 rad/s", in_rad_per_s(*GRID), ALL_MOTIONS)
TIP_PRINTED = Reading("tip deflection, 0.5 to 6 rad/s (as printed)", in_rad_per_s(*GRID), (TIP,))
TIP_IN_HZ = Reading("tip deflection, 0.5 to 6 Hz", GRID, (TIP,))
TIP_NODE = Reading("tip deflection and rotation, 0.5 to 6 rad/s", in_rad_per_s(*GRID), (TIP, "6RZ+"))
TWO_DEFLECTIONS = Reading("deflections of nodes 1 and 6, 0.5 to 6 rad/s", in_rad_per_s(*GRID), ("1Y+", TIP))


def cantilever(values: FloatArray) -> Structure:
    """Cantilever of six beam elements of 1 m, clamped at node 0, which bends in Y.

    `values` (12,) are masses per length (kg/m) and then stiffnesses EI (N m^2).
    """
    beam = Beam("beam", [[i, i + 1] for i in range(N_ELEMENTS)], values[:N_ELEMENTS], values[N_ELEMENTS:])
    return Structure({i: float(i) for i in range(N_ELEMENTS + 1)}, [beam], ["0Y", "0RZ"])


def unknowns(structure: Structure) -> Parameters:
    """All masses and stiffnesses, free to take any sign, as the classical iteration has them."""
    return parameters(structure, _UNKNOWNS)


def exact_record(values: FloatArray, reading: Reading) -> FrfRecord:
    """Noise-free receptances of the cantilever at the lines and sensors of `reading`, for a load at the tip.

    `values` (12,) are masses per length (kg/m) and then stiffnesses EI (N m^2).
    """
    frequency = np.array(reading.frequency)
    blank = np.ones((len(frequency), len(reading.outputs), 1), dtype=np.complex128)
    record = FrfRecord(frequency, blank, parse_dofs(reading.outputs), parse_dofs((TIP,)), "receptance")
    structure = cantilever(values)
    return replace(record, values=response(structure, unknowns(structure), record).values_at(values))


def rms(relative_error: FloatArray) -> float:
    """Root mean square of `relative_error` over all parameters."""
    return float(np.sqrt(np.mean(np.square(relative_error))))


def classical_values(case: Case, record: FrfRecord, n_iterations: int) -> FloatArray:
    """Parameters along the classical iteration from the postulated ones, (n, 12) with n <= n_iterations + 1.

    Eqs. (4.17) and (4.26). It ends early if the RMS error exceeds `DIVERGED` or the model cannot be evaluated. The steps are
    those of ``GaussNewton(step_control=False)``.
    """
    structure = cantilever(case.postulated)
    problem = FrfProblem(structure, unknowns(structure), record, "equation")
    path = [np.array(case.postulated)]
    with np.errstate(all="ignore"):
        while len(path) <= n_iterations:
            try:
                linearization = problem.linearize(path[-1])
                values = path[-1] - np.linalg.lstsq(linearization.jacobian, linearization.residual, rcond=None)[0]
            except (np.linalg.LinAlgError, SingularModelError):
                break
            if not rms(values / case.actual - 1) < DIVERGED:
                break
            path.append(values)
    return np.array(path)


def classical_errors(case: Case, record: FrfRecord, n_iterations: int = 6) -> FloatArray:
    """RMS of the relative errors along the classical iteration, (n_iterations + 1,), the start first; inf after divergence."""
    path = classical_values(case, record, n_iterations)
    errors = np.full(n_iterations + 1, np.inf)
    errors[: len(path)] = np.sqrt(np.mean((path / case.actual - 1) ** 2, axis=1))
    return errors


def one_step_solution(case: Case, record: FrfRecord) -> FloatArray:
    """Parameters (12,) from one linear solve with the measured motion in B; `record` must hold every motion."""
    structure = cantilever(case.postulated)
    return one_step_values(structure, unknowns(structure), record)


def relative_jacobian(case: Case, reading: Reading) -> FloatArray:
    """Relative change of each datum for a relative change of each parameter, (n_data, 12), at the actual parameters."""
    structure = cantilever(case.actual)
    model = response(structure, unknowns(structure), exact_record(case.actual, reading))
    values, derivative = model.derivatives_at(case.actual)
    return (derivative / values[..., None] * case.actual).real.reshape(-1, len(case.actual))


def iterations_to(errors: FloatArray) -> float:
    """Index of the first of `errors` below `CONVERGED` (0 is the start); NaN if there is none."""
    below = np.flatnonzero(errors < CONVERGED)
    return float(below[0]) if below.size else float("nan")
