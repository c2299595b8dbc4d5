"""A model as state equations of low order, for controllers and simulators, with the error that its order makes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray, square_root
from structid.core.constraints import require_band
from structid.core.display import Overview, Shown, format_number, join_words
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError, NoAnswerError
from structid.files import atomic_write
from structid.identification.identified import Identification
from structid.prediction.identified_model import IdentifiedModel, model_of
from structid.prediction.poles import ReducedMatrices, Sides, reduce_structure, reduction_basis, sum_over_poles
from structid.records.record import MOTION_DERIVATIVES

#: Lines of the band on which the error is looked at; and the least ratio of its ends.
_LINES, _LEAST = 500, 1e-3
#: Ends of the bands on which equations are balanced, in parts of the highest frequency.
_BANDS = 1.0, 1.05, 1.15, 1.3
#: Least decay of a pole that is made stable, in parts of its size.
_LEAST_DECAY = 1e-4
#: Lines across the half-power band of a resonance, three times as wide.
_ACROSS = 25
SUFFIXES = (".mat", ".npz", ".h5")


@dataclass(frozen=True, eq=False, repr=False)
class StateSpace(Shown):
    """x' = a x + b u and y = c x + d u; of sampled equations x' is the state at the next sample.

    Attributes
    ----------
    a, b, c, d : float arrays
        (n_states, n_states), (n_states, n_inputs), (n_outputs, n_states) and (n_outputs, n_inputs); SI units.
    outputs, inputs : tuple of Dof
    motion : {"displacement", "velocity", "acceleration"}
    band : (float, float)
        Hz.
    error : float
        Largest error of the FRFs in the band, in parts of their largest value there; what viscous dampings in place of loss factors
        change is part of it.
    sampling_rate : float or None
        Samples per second; None in continuous time.
    draws : tuple of (a, b, c, d)
        The same of models within the uncertainty, each in coordinates of its own. One that needs fewer states has some at rest.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    motion: str
    band: tuple[float, float]
    error: float
    sampling_rate: float | None = None
    draws: tuple[tuple[FloatArray, FloatArray, FloatArray, FloatArray], ...] = ()

    def overview(self) -> Overview:
        """A line with the number of states, the channels and the largest error of FRFs."""
        kind = "continuous time" if self.sampling_rate is None else f"{self.sampling_rate:g} samples a second"
        error = format_number(100 * self.error, 2)
        return Overview(
            f"{len(self.a)} states in {kind}, {self.motion} at {join_words(self.outputs)} under forces at"
            f" {join_words(self.inputs)};"
            f" largest error of FRFs from {self.band[0]:g} to {self.band[1]:g} Hz {error} % of the largest"
        )

    def frf(self, frequency: FloatArray) -> np.ndarray:
        """FRFs at `frequency` in Hz, (n_frequencies, n_outputs, n_inputs) complex."""
        s = 2j * np.pi * np.asarray(frequency)
        point = s if self.sampling_rate is None else np.exp(s / self.sampling_rate)
        states = np.linalg.solve(point[:, None, None] * np.eye(len(self.a)) - self.a, self.b.astype(complex))
        return np.asarray(self.c @ states + self.d)

    def write(self, path: str | Path) -> None:
        """Write the equations to a .mat (MATLAB 5), .npz or .h5 file, complete or not at all.

        Arrays are a, b, c and d, names of outputs and inputs, motion, band, error and sampling rate (0 in continuous
        time); models drawn are a_draws and so on, with a leading axis.

        Raises
        ------
        FileError
            If the suffix is another, or the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() not in SUFFIXES:
            raise FileError(
                f"{path}: state equations are written to {', '.join(SUFFIXES)}; give the file one of these suffixes"
            )
        content: dict[str, object] = {
            "a": self.a, "b": self.b, "c": self.c, "d": self.d,
            "outputs": np.array([str(dof) for dof in self.outputs]), "inputs": np.array([str(dof) for dof in self.inputs]),
            "motion": np.array(self.motion), "band_hz": np.array(self.band), "largest_error": np.array(self.error),
            "sampling_rate_hz": np.array(0.0 if self.sampling_rate is None else self.sampling_rate),
        }  # fmt: skip
        for name, parts in zip(("a", "b", "c", "d"), zip(*self.draws, strict=True), strict=False):
            content[f"{name}_draws"] = np.stack(parts)
        with atomic_write(path) as temporary:
            temporary.write_bytes(_encode_arrays(path.suffix.lower(), content))


def _encode_arrays(suffix: str, content: dict[str, object]) -> bytes:
    """Content of a file that holds the arrays of `content` by name, in the format of `suffix`: .npz, .mat or .h5."""
    buffer = io.BytesIO()
    if suffix == ".npz":
        np.savez_compressed(buffer, **content)  # type: ignore[arg-type]
    elif suffix == ".mat":
        from scipy.io import savemat  # so that the command starts quickly

        savemat(buffer, content)
    else:
        import h5py

        with h5py.File(buffer, "w") as file:
            for name, value in content.items():
                array = np.asarray(value)
                file.create_dataset(
                    name, data=array.astype("S") if array.dtype.kind == "U" else array, track_times=False
                )
    return buffer.getvalue()


def state_space(
    source: Identification | IdentifiedModel,
    outputs: Sequence[Dof | str],
    inputs: Sequence[Dof | str],
    band: tuple[float, float],
    motion: str = "acceleration",
    order: int | None = None,
    error: float = 0.01,
    sampling_rate: float | None = None,
    n_draws: int = 0,
    seed: int = 0,
) -> StateSpace:
    """State equations of an identified model from loads to sensors, of the lowest order that the error allows.

    They are balanced on that band and on some that end above it (Gawronski and Juang 1990) and cut off where this
    misses least; free rigid motions are kept whole. Loss factors act as viscous dampings that take as much energy at
    each resonance.

    Parameters
    ----------
    source : Identification or IdentifiedModel
    outputs, inputs : sequence of Dof or str
        Sensors and loads.
    band : (float, float)
        Hz: where the equations must hold.
    motion : {"displacement", "velocity", "acceleration"}
        Quantity that the outputs read.
    order : int, optional
        Number of states; by default the fewest whose largest error in the band is at most `error`.
    error : float
        In parts of the largest FRF in the band.
    sampling_rate : float, optional
        Equations from sample to sample, exact for loads that stay constant in between; continuous time by default. Hz,
        more than twice the upper end of the band.
    n_draws : int
        Models within the uncertainty whose equations are given too, with as many states.
    seed : int
        Of those models.

    Returns
    -------
    StateSpace
        Matrices a, b, c and d in SI units, the error reached, and those of the models drawn. The error is that against
        the FRFs with loss factors as they are.

    Raises
    ------
    InputError
        If the band, the motion, the sampling rate or the order cannot be.
    NoAnswerError
        If no order reaches `error`, or the data do not determine the model.

    References
    ----------
    Gawronski and Juang (1990), Int. J. Systems Sci. 21, 349-376; Moore (1981), IEEE Trans. Automatic Control 26, 17-32.
    """
    require_band("band", band, is_open_allowed=False)
    low, high = float(band[0]), float(band[1])
    if motion not in MOTION_DERIVATIVES:
        raise InputError(f"`motion` must be one of {', '.join(MOTION_DERIVATIVES)}, got {motion!r}")
    if sampling_rate is not None and not sampling_rate > 2 * high:
        raise InputError(
            f"`sampling_rate` must be more than twice the highest frequency of `band`, {high:g} Hz, got {sampling_rate:g}"
        )
    model = model_of(source)
    sensors, loads, structure = parse_dofs(outputs), parse_dofs(inputs), model.structure
    structure.require_scaled_modes("state equations")
    sides = Sides(structure.selection(sensors), structure.selection(loads))
    basis = reduction_basis(structure, [model.values], sides, max(low, _LEAST * high), high)
    nominal = reduce_structure(structure, model.values, basis, sides)
    whole = _Equations.from_reduced(nominal, MOTION_DERIVATIVES[motion])
    frequency = _judged_lines(nominal, max(low, _LEAST * high), high)
    exact, balances = whole.frf(frequency), whole.balance(high)
    fewest = max(2, whole.n_rigid)
    if order is None:
        orders = range(fewest, whole.n_states + 1, 2)
        cuts = (whole.cut(n, high, balances, frequency, exact) for n in orders)
        first = next((cut for cut in cuts if cut.miss(frequency, exact) <= error), None)
        if first is None:
            raise NoAnswerError(
                f"no order gives an error of at most {error:g} in the band; allow more, or name the order"
            )
        made = first
    else:
        if not fewest <= order <= whole.n_states:
            raise InputError(f"`order` must be from {fewest} to {whole.n_states} in this band, got {order}")
        made = whole.cut(order, high, balances, frequency, exact)
        if made.n_states < order:
            raise InputError(
                f"`order` must be at most {made.n_states}, got {order}: these loads and sensors see no more states; ask for"
                " fewer"
            )
    hysteretic = sum_over_poles(nominal).frf(frequency)
    hysteretic = hysteretic * ((2j * np.pi * frequency) ** MOTION_DERIVATIVES[motion])[:, None, None]
    largest = made.miss(frequency, hysteretic)
    draws = []
    for physical in model.draw_parameters(n_draws, np.random.default_rng(seed)) if n_draws else ():
        other = _Equations.from_reduced(
            reduce_structure(structure, model.parameters.values(physical), basis, sides), MOTION_DERIVATIVES[motion]
        )
        if made.n_states < other.n_states:
            other = other.cut(made.n_states, high, other.balance(high), frequency, other.frf(frequency))
        draws.append(other.padded(made.n_states, high).sampled(sampling_rate))
    parts = made.sampled(sampling_rate)
    return StateSpace(*parts, sensors, loads, motion, (low, high), largest, sampling_rate, tuple(draws))


def _judged_lines(reduced: ReducedMatrices, low: float, high: float) -> FloatArray:
    """Increasing frequencies, Hz, (n_lines,), at which an error is judged: 500 evenly spaced, 25 across a resonance.

    `low` and `high` are the ends of the band, Hz; frequencies outside it are left out. Those of a resonance span three
    half bandwidths on either side.
    """
    omega = reduced.omega[~reduced.is_rigid]
    half = np.diag(reduced.viscous_equivalent())[~reduced.is_rigid] / 2
    near = (omega + half * np.linspace(-3, 3, _ACROSS)[:, None]).ravel() / (2 * np.pi)
    lines = np.concatenate([np.linspace(low, high, _LINES), near[(near > low) & (near < high)]])
    return np.unique(lines)


@dataclass(frozen=True, eq=False)
class _Balance:
    """Balanced coordinates of equations, most important first: columns (n, n_balanced) to their states, and rows back."""

    states: FloatArray
    back: FloatArray


@dataclass(frozen=True, eq=False)
class _Equations:
    """State equations x' = a x + b u, y = c x + d u; the first `n_rigid` states are those of free rigid motions.

    With `is_differentiated` the outputs that are asked for are the derivatives of y in time.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    n_rigid: int
    is_differentiated: bool

    @classmethod
    def from_reduced(cls, reduced: ReducedMatrices, derivatives: int) -> _Equations:
        """State equations of a reduced structure; states are modal displacements times omega, and modal speeds.

        Outputs are displacements for `derivatives` 0, else speeds; for 2 they are marked to be differentiated. The states of
        free rigid motions come first.
        """
        rigid = reduced.is_rigid
        order = np.concatenate([np.flatnonzero(rigid), np.flatnonzero(~rigid)])
        omega, n, n_rigid = reduced.omega[order], len(order), int(rigid.sum())
        damping = reduced.viscous_equivalent()[np.ix_(order, order)]
        out, into = reduced.outputs[:, order], reduced.inputs[order]
        scale = np.where(np.arange(n) < n_rigid, 1.0, np.maximum(omega, 1e-12))
        stiff = np.where(np.arange(n) < n_rigid, 0.0, omega)
        a = np.block([[np.zeros((n, n)), np.diag(scale)], [-np.diag(stiff), -damping]])
        b = np.vstack([np.zeros_like(into), into])
        place = np.hstack([out / scale, np.zeros_like(out)])
        speed = np.hstack([np.zeros_like(out), out])
        c = place if derivatives == 0 else speed
        d = np.zeros((len(out), into.shape[1]))
        states = np.concatenate([np.arange(n_rigid), n + np.arange(n_rigid)])
        rest = np.setdiff1d(np.arange(2 * n), states)
        turn = np.concatenate([states, rest])
        return cls(a[np.ix_(turn, turn)], b[turn], c[:, turn], d, 2 * n_rigid, derivatives == 2)

    @property
    def n_states(self) -> int:
        return len(self.a)

    def frf(self, frequency: FloatArray) -> np.ndarray:
        """FRFs of the equations in continuous time at `frequency` (Hz), (n_frequencies, n_outputs, n_inputs)."""
        poles, vectors = np.linalg.eig(self.a[self.n_rigid :, self.n_rigid :])
        into = np.linalg.solve(vectors, self.b[self.n_rigid :].astype(complex))
        out = self.c[:, self.n_rigid :] @ vectors
        s = 2j * np.pi * frequency
        total = np.einsum("fk,ok,ki->foi", 1 / (s[:, None] - poles), out, into) + self.d
        if self.n_rigid:
            r = slice(0, self.n_rigid)
            states = np.linalg.solve(s[:, None, None] * np.eye(self.n_rigid) - self.a[r, r], self.b[r].astype(complex))
            total = total + self.c[:, r] @ states
        return np.asarray(total * s[:, None, None] if self.is_differentiated else total)

    def miss(self, frequency: FloatArray, exact: np.ndarray) -> float:
        """Largest error of the FRFs at `frequency` (n_lines,), Hz, over the largest magnitude of the `exact` ones."""
        return float(np.abs(self.frf(frequency) - exact).max() / np.abs(exact).max())

    def balance(self, highest: float) -> list[_Balance]:
        """Balanced coordinates for bands that end at or above `highest` Hz, the last for all frequencies.

        An empty list if there are only rigid motions.
        """
        if self.n_states == self.n_rigid:
            return []
        return [self._balance_states(highest * factor) for factor in _BANDS] + [self._balance_states(None)]

    def cut(
        self, order: int, highest: float, balances: Sequence[_Balance], frequency: FloatArray, exact: np.ndarray
    ) -> _Equations:
        """Stable equations with `order` states, by that of the `balances` with the smallest error.

        The error is judged against `exact`, the FRFs of these equations at `frequency` (Hz). Balancing on a band may
        lose a resonance just above it; balancing over all frequencies does not, but spends states on what is outside
        the band. `highest` is the upper end of the band, Hz. `self` is returned if it has no more states than `order`.
        """
        if order >= self.n_states:
            return self
        cuts = (self._cut_states(order, highest, balance) for balance in balances)
        return min(cuts, key=lambda cut: cut.miss(frequency, exact))

    def _cut_states(self, order: int, highest: float, balance: _Balance) -> _Equations:
        """Equations with the rigid states and the leading balanced states, `order` in all, made stable.

        `highest` is the upper end of the band, Hz; at half of it a direct part makes up for what was cut, unless
        outputs are differentiated. `balance` has the balanced coordinates.
        """
        keep, r = max(order - self.n_rigid, 0), self.n_rigid
        a, b, c = self.a[r:, r:], self.b[r:], self.c[:, r:]
        left, right = balance.back[:keep], balance.states[:, :keep]
        without = replace(
            self,
            a=linalg.block_diag(self.a[:r, :r], _reflect_unstable_poles(left @ a @ right, self._least_decay)),
            b=np.vstack([self.b[:r], left @ b]),
            c=np.hstack([self.c[:, :r], c @ right]),
            d=np.zeros_like(self.d),
        )
        if self.is_differentiated:
            return without
        middle = np.array([0.5 * highest])  # where the direct part makes up for what was cut
        return replace(without, d=(self.frf(middle) - without.frf(middle))[0].real)

    @cached_property
    def _least_decay(self) -> float:
        """Least decay of the poles that are no rigid motions, in parts of their size, from 0 to `_LEAST_DECAY`."""
        poles = np.linalg.eigvals(self.a[self.n_rigid :, self.n_rigid :])
        return float(np.clip((-poles.real / np.abs(poles)).min(), 0.0, _LEAST_DECAY))

    def _balance_states(self, highest: float | None) -> _Balance:
        """Balanced coordinates of all but the rigid states on the band from 0 to `highest` Hz, most important first.

        Columns (n, n) times balanced coordinates are the n states, rows (n, n) times these are balanced coordinates.
        None for `highest` takes all frequencies.
        """
        r = self.n_rigid
        a, b, c = self.a[r:, r:], self.b[r:], self.c[:, r:]
        one = np.eye(len(a))
        inside = one / 2
        if highest is not None:
            omega = 2 * np.pi * highest
            inside = (1j / (2 * np.pi) * linalg.logm((a + 1j * omega * one) @ np.linalg.inv(a - 1j * omega * one))).real
        reach = linalg.solve_continuous_lyapunov(a, -(inside @ b @ b.T + b @ b.T @ inside.T))
        seen = linalg.solve_continuous_lyapunov(a.T, -(inside.T @ c.T @ c + c.T @ c @ inside))
        roots = [square_root(matrix) for matrix in (reach, seen)]
        left, sizes, right = np.linalg.svd(roots[1].T @ roots[0], full_matrices=False)
        size = 1 / np.sqrt(np.maximum(sizes, np.finfo(float).tiny))
        return _Balance(roots[0] @ right.T * size, (roots[1] @ left * size).T)

    def padded(self, order: int, highest: float) -> _Equations:
        """Equations with `order` states in all: states that stay at rest are appended to the present ones.

        `highest`, Hz, sets how fast the appended states decay. Nothing is appended to `order` states or more.
        """
        extra = max(order - self.n_states, 0)
        a = linalg.block_diag(self.a, -2 * np.pi * highest * np.eye(extra))
        b, c = np.pad(self.b, ((0, extra), (0, 0))), np.pad(self.c, ((0, 0), (0, extra)))
        return replace(self, a=a, b=b, c=c)

    def sampled(self, rate: float | None) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Matrices a, b, c, d from sample to sample for loads constant in between; continuous, 1/s, if `rate` is None.

        `rate` is in Hz. The matrices are (n, n), (n, n_inputs), (n_outputs, n) and (n_outputs, n_inputs) with n states.
        Differentiated outputs, accelerations, become a part of the state and a direct part of the loads.
        """
        c, d = (self.c @ self.a, self.d + self.c @ self.b) if self.is_differentiated else (self.c, self.d)
        if rate is None:
            return self.a, self.b, c, d
        n, m = self.b.shape
        wide = np.zeros((n + m, n + m))
        wide[:n, :n], wide[:n, n:] = self.a / rate, self.b / rate
        step = linalg.expm(wide)[:n]
        return step[:, :n], step[:, n:], c, d


def _reflect_unstable_poles(a: FloatArray, least: float) -> FloatArray:
    """Matrix `a` with unstable poles reflected, so that they decay as fast as they grew.

    Reflected are poles that grow, or decay by less than half of `least` times their size; they then decay by at least
    1e-4 of their size. Balancing on a band moves poles outside it across the imaginary axis, or onto it; in the band
    the reflected ones act alike. `a` is (n, n).
    """
    poles, vectors = np.linalg.eig(a)
    slow = poles.real > -0.5 * least * np.abs(poles)
    if not slow.any():
        return a
    decays = -np.maximum(np.abs(poles.real), _LEAST_DECAY * np.abs(poles))
    stable = np.where(slow, decays + 1j * poles.imag, poles)
    return np.asarray(np.linalg.solve(vectors.T, (vectors * stable).T).T.real)
