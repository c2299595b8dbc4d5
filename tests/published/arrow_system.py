"""The system with pseudo-parameters as it is printed, dense: the oracle for the form that eliminates them.

Norris (1986), Eqs. (4.19) to (4.26), with A = [B, -E] in (4.22a) and, where there is damping, real and imaginary parts
stacked, so that the parameters stay real.
"""

import numpy as np

LAWS = ("mass", "damping", "stiffness", "structural_damping")


class ArrowSystem:
    """Step of all unknowns together: parameters, and the unmeasured motion at every frequency."""

    def __init__(self, structure, unknown, record):
        self.record, self.hidden = record, []
        self.sensors = [structure.dofs.index(dof) for dof in record.outputs]
        self.hidden = [i for i in range(structure.n_dofs) if i not in self.sensors]
        self.load = structure.selection(record.inputs).toarray()[:, 0]
        values = unknown.values(unknown.start)
        at = {kind: structure.matrix(kind, values).toarray() for kind in LAWS}
        units = np.eye(unknown.n_params)
        moved = [unknown.values(unknown.start + unit) for unit in units]
        self.matrices = at
        self.slopes = {kind: np.array([structure.matrix(kind, v).toarray() - at[kind] for v in moved]) for kind in LAWS}

    def dynamic_stiffness(self, omega, matrices):
        undamped = matrices["stiffness"] - omega**2 * matrices["mass"]
        return undamped + 1j * (omega * matrices["damping"] + matrices["structural_damping"])

    def system(self):
        """A and d of Eqs. (4.23) and (4.24), complex."""
        n_hidden, n_params = len(self.hidden), len(self.slopes["mass"])
        rows, right = [], []
        for e, omega in enumerate(self.record.omega):
            z = self.dynamic_stiffness(omega, self.matrices)
            motion = np.linalg.solve(z, self.load)
            row = np.zeros((len(z), n_params + len(self.record.omega) * n_hidden), dtype=complex)
            row[:, :n_params] = (self.dynamic_stiffness(omega, self.slopes) @ motion).T
            row[:, n_params + e * n_hidden : n_params + (e + 1) * n_hidden] = z[:, self.hidden]  # -E
            rows.append(row)
            right.append(-z[:, self.sensors] @ (self.record.values[e, :, 0] - motion[self.sensors]))
        return np.concatenate(rows), np.concatenate(right)

    def step(self):
        """Least-squares correction of the parameters."""
        matrix, right = self.system()
        n_params = len(self.slopes["mass"])
        if not matrix.imag.any() and not right.imag.any():
            return np.linalg.lstsq(matrix.real, right.real, rcond=None)[0][:n_params]
        real, other = matrix[:, :n_params], matrix[:, n_params:]
        stacked = np.block([[real.real, other.real, -other.imag], [real.imag, other.imag, other.real]])
        return np.linalg.lstsq(stacked, np.concatenate([right.real, right.imag]), rcond=None)[0][:n_params]
