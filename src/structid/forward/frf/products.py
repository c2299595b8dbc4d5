"""Forms of the whitened residual of FRFs, and products with its Jacobian, J v and J'u, from the fields of every line.

With X = Z^-1 F and Y = Z^-1 S at every line, J v = -Y' (sum of v_p dZ/dp) X and J'u = -(sum over lines of q' (dZ/dp) x)
with q = Y u. Fields are kept, so a product costs a small part of one factorization.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, stack_real
from structid.core.errors import InputError
from structid.forward.frf.response import Response
from structid.forward.sensitivity import WeightedParts, element_products

#: Largest Jacobian of the data, in bytes, that is stored nevertheless: products with it are then faster.
STORED_BYTES = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Whitening:
    """Derivative of a whitened complex residual r with respect to the response h: dr = own dh + other conj(dh).

    Attributes
    ----------
    own, other : (n_frequencies, n_outputs, n_inputs) complex arrays
        `other` is None where it is 0.
    """

    own: ComplexArray
    other: ComplexArray | None = None

    def rows(self, change: ComplexArray) -> ComplexArray:
        """Change of the residual by changes of the response, (n_frequencies, n_outputs, n_inputs, n_columns) both."""
        rows: ComplexArray = self.own[..., None] * change
        return rows if self.other is None else rows + self.other[..., None] * np.conj(change)

    def scaled(self, factor: ComplexArray) -> Whitening:
        """Derivative by h of the residual whose response is `factor` times h; `factor` broadcasts with the response."""
        return Whitening(self.own * factor, None if self.other is None else self.other * np.conj(factor))

    def functional(self, u: ComplexArray) -> ComplexArray:
        """Weights w, shaped as the response, with Re(conj(u) dr) = Re(w dh) for `u`, shaped as the residual r."""
        weights: ComplexArray = np.conj(u) * self.own
        return weights if self.other is None else weights + u * np.conj(self.other)


@dataclass(frozen=True, eq=False)
class FieldJacobian:
    """The derivative of an FRF with respect to physical parameters, applied from fields.

    Attributes
    ----------
    model : Response
    parts : WeightedParts
    factors : (n_frequencies, n_kinds) complex array
        Coefficient of each kind of part in the dynamic stiffness.
    x : (n_dofs, n_frequencies n_inputs) complex array
        Motions under the loads, lines slowest.
    y : (n_frequencies, n_outputs, n_dofs) complex array
        Motions under unit forces at the sensors.
    """

    model: Response
    parts: WeightedParts
    factors: ComplexArray
    x: ComplexArray
    y: ComplexArray

    def forward(self, v: FloatArray) -> ComplexArray:
        """Change of the FRF, (n_frequencies, n_outputs, n_inputs), by a change `v` (n_params,) of physical parameters.

        It is the product J v with the derivative J of the FRF, to first order.
        """
        n_lines, _, n_dofs = self.y.shape
        flat = self.x.view(np.float64)
        forces = np.zeros((n_dofs, n_lines, self.x.shape[1] // n_lines), dtype=np.complex128)
        for kind, matrix in self._changes(v).items():
            moved = (matrix @ flat).view(np.complex128).reshape(forces.shape)
            moved *= self.factors[:, kind, None]
            forces += moved
        change = self.y @ np.ascontiguousarray(np.moveaxis(forces, 0, 1))
        return np.asarray(-self.model.kind_factor[:, None, None] * change)

    def adjoint(self, w: ComplexArray) -> FloatArray:
        """Real part of the sum of w dH/dp over all FRF entries, (n_params,), without conjugate.

        `w` (n_frequencies, n_outputs, n_inputs) are complex weights, H the FRF and p the physical parameters.
        """
        n_dofs = self.y.shape[2]
        weighted = w * -self.model.kind_factor[:, None, None]
        drive = np.ascontiguousarray(np.moveaxis(np.swapaxes(self.y, 1, 2) @ weighted, 1, 0))
        total = np.zeros(self.model.parameters.n_params)
        left: dict[int, ComplexArray] = {}
        for part in self.parts.parts:
            if part.kind not in left:
                weighted_drive = np.conj(drive * self.factors[:, part.kind, None])
                left[part.kind] = weighted_drive.reshape(n_dofs, -1)
            total += part.slope.T @ element_products(part.blocks, left[part.kind], self.x)
        return total

    def _changes(self, v: FloatArray) -> dict[int, sparse.csr_array]:
        """Change of the weighted element matrices of each kind, (n_dofs, n_dofs) sparse, by the number of the kind.

        It is linear in `v` (n_params,), a change of the physical parameters. Parts of one kind enter the dynamic
        stiffness with one factor.
        """
        assembled = self.model.slopes.assembled
        entries: dict[int, FloatArray] = {}
        for part, (member, rows) in zip(self.parts.parts, self.parts.members, strict=True):
            change = np.zeros(assembled.maps[member].shape[1])
            change[rows] = part.slope @ v
            entries[part.kind] = entries.get(part.kind, 0.0) + assembled.maps[member] @ change
        shape = (len(assembled.indptr) - 1,) * 2  # symmetric: columns are rows
        return {
            kind: sparse.csr_array((data, assembled.indices, assembled.indptr), shape) for kind, data in entries.items()
        }


@dataclass(frozen=True, eq=False)
class ResponseProducts:
    """An FRF and products with the Jacobian of its whitened residual, physical parameters.

    Attributes
    ----------
    values : (n_frequencies, n_outputs, n_inputs) complex array
    forward, adjoint : callables
        J v and J'u; rows are all real parts, then all imaginary parts.
    squares : (n_params,) float array
        Diagonal of J'J.
    words : str
        Phrase that says whether the Jacobian is stored or applied from fields, with sizes in MB.
    jacobian : (n_data, n_params) float array or None
        J if it is stored, else None.
    """

    values: ComplexArray
    forward: Callable[[FloatArray], FloatArray]
    adjoint: Callable[[FloatArray], FloatArray]
    squares: FloatArray
    words: str
    jacobian: FloatArray | None = None


def response_products(
    model: Response,
    physical: FloatArray,
    whitening: Callable[[ComplexArray, slice], Whitening],
    stored_bytes: float = STORED_BYTES,
) -> ResponseProducts:
    """FRFs and products with the Jacobian of their whitened residual, and with its transpose, at given parameters.

    Parameters
    ----------
    model : Response
        Of a structure without sliding friction.
    physical : (n_params,) float array
    whitening : callable
        From the response (n, n_outputs, n_inputs) and the slice of its n lines to the derivative of the residual.
    stored_bytes : float
        The Jacobian is stored where it takes no more than this, and applied from fields otherwise.

    Returns
    -------
    ResponseProducts
        FRFs (n_frequencies, n_outputs, n_inputs), J v, J'u, the diagonal of J'J, and J or None. Rows of J are all real
        parts, then all imaginary parts; columns are physical parameters.

    Raises
    ------
    InputError
        If the model has sliding friction.
    """
    if model.contacts:
        raise InputError(
            "a matrix-free search needs a structure without sliding friction; give `measured_sliding`,"
            " or fewer parameters"
        )
    shape = (len(model.frequency), model.channels.n_outputs, len(model.channels.inputs[0]))
    n_params, n_dofs = model.parameters.n_params, model.slopes.structure.n_dofs
    size = 16 * int(np.prod(shape)) * n_params
    stored = np.empty((2, *shape, n_params)) if size <= stored_bytes else None
    forces, factors = model.slopes.forces_at(physical, model.fixed_coefficients)
    x = np.empty((n_dofs, shape[0], shape[2]), dtype=np.complex128)
    y = np.empty((shape[0] if stored is None else 0, shape[1], n_dofs), dtype=np.complex128)
    values, squares = np.empty(shape, dtype=np.complex128), np.zeros(n_params)
    (loads, load_signs), (sensors, signs) = model.channels.inputs, model.channels.outputs
    used, column_of = np.unique(loads, return_inverse=True)
    for part, solved in model.solved_at(physical):
        for line, fields in zip(range(shape[0])[part], solved, strict=True):
            x[:, line] = fields[:, loads] * load_signs
            values[line] = model.channels.read(x[None, :, line])[0] * model.kind_factor[line]
            products = np.stack(forces.products(factors[line], fields[:, used], fields))[column_of][:, :, sensors]
            scale = -model.kind_factor[line] * np.outer(signs, load_signs)
            change = whitening(values[line : line + 1], slice(line, line + 1)).rows(
                (np.moveaxis(products, 2, 0) * scale[..., None])[None]
            )[0]
            squares += (change.real**2 + change.imag**2).sum(axis=(0, 1))
            if stored is None:
                y[line] = (fields[:, sensors] * signs).T
            else:
                stored[0, line], stored[1, line] = change.real, change.imag
    if stored is not None:
        matrix = stored.reshape(-1, n_params)
        words = f"the Jacobian of the data, {size / 1e6:.0f} MB, is stored"
        return ResponseProducts(values, lambda v: matrix @ v, lambda u: matrix.T @ u, squares, words, matrix)
    parts, _ = model.slopes.parts_at(physical, model.fixed_coefficients)
    jacobian = FieldJacobian(model, parts, factors, x.reshape(n_dofs, -1), y)
    white = whitening(values, slice(None))
    words = (
        f"the Jacobian of the data would take {size / 1e6:.0f} MB and is applied from fields, {y.nbytes / 1e6:.0f} MB"
    )

    def forward(v: FloatArray) -> FloatArray:
        return stack_real(white.rows(jacobian.forward(v)[..., None]).ravel())

    def adjoint(u: FloatArray) -> FloatArray:
        real, imaginary = np.split(u, 2)
        return jacobian.adjoint(white.functional((real + 1j * imaginary).reshape(shape)))

    return ResponseProducts(values, forward, adjoint, squares, words)


Form = Literal["output", "log", "pole_free", "equation"]
#: Values below so many deviations are compared as they are in ``log`` too: noise has no logarithm. Of the model's own values, what
#: part of a deviation is the least.
_IN_NOISE, _LEAST = 3.0, 1e-3


@dataclass(frozen=True, eq=False)
class WhitenedFrf:
    """Measured FRFs in one of the forms that `FrfProblem` names, but ``equation``, which needs the model.

    Parameters
    ----------
    form : Form
    measured : (n_frequencies, n_outputs, n_inputs) complex array
    deviation : (n_frequencies, n_outputs, n_inputs) float array
        Standard deviation of the real (and of the imaginary) part of every value.
    """

    form: Form
    measured: ComplexArray
    deviation: FloatArray

    def residual(self, h: ComplexArray) -> ComplexArray:
        """Weighted complex residual of the FRFs `h` of a model against the measured FRFs m, of the shape of `h`.

        With s the standard deviation it is (h - m) / s for form ``output``, log(h / m) |m| / s for ``log`` (as
        ``output`` for values in the noise), and else (h - m) / sqrt((|h|^2 + |m|^2) / 2) |m| / s. `h` is (...,
        n_frequencies, n_outputs, n_inputs).
        """
        m, s = self.measured, self.deviation
        if self.form == "output":
            return (h - m) / s
        if self.form == "log":
            logarithmic = _log(h * self._inverse, _LEAST / np.maximum(self._weight, 1.0)) * self._weight
            return np.where(self._in_noise, (h - m) / s, logarithmic) if self._in_noise.any() else logarithmic
        return (h - m) / np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2)) * self._weight

    def whitening(self, h: ComplexArray, lines: slice = slice(None)) -> Whitening:
        """Derivative of the weighted residual by the model's FRFs `h` (n, n_outputs, n_inputs) at the lines `lines`.

        A change dh of the FRFs changes the residual by own dh + other conj(dh); both factors have the shape of `h`. The
        form of the residual is that of this object.
        """
        if self.form == "output":
            return Whitening((1 / self.deviation[lines]).astype(np.complex128))
        m, weight = self.measured[lines], self._weight[lines]
        if self.form == "log":
            s, size = self.deviation[lines], np.abs(h)
            of_log = np.divide(weight, h, out=np.zeros_like(h), where=size > _LEAST * s)
            return Whitening(np.where(self._in_noise[lines], 1 / s, of_log))
        size = np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2))
        turn = (h - m) * weight / (4 * size**3)
        return Whitening(weight / size - turn * np.conj(h), -turn * h)

    @cached_property
    def _weight(self) -> FloatArray:
        """Weights of relative residuals."""
        return np.asarray(np.abs(self.measured) / self.deviation)

    @cached_property
    def _in_noise(self) -> np.ndarray:
        return np.asarray(np.abs(self.measured) < _IN_NOISE * self.deviation)

    @cached_property
    def _inverse(self) -> ComplexArray:
        return np.asarray(1 / np.where(self._in_noise, 1.0, self.measured))


def _log(z: ComplexArray, least: FloatArray) -> ComplexArray:
    """Principal logarithm of `z`, whose magnitude is raised to `least` if smaller; the result has the shape of `z`.

    `least` broadcasts to `z`. The imaginary part is the phase, from -pi to pi.
    """
    logarithm = np.empty_like(z)
    size = np.abs(z)
    np.log(np.maximum(size, least, out=size), out=logarithm.real)
    np.arctan2(z.imag, z.real, out=logarithm.imag)
    return logarithm
