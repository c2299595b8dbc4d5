"""What the data of a case can tell at all: how far the fault shows, what it does to the answer, and what else explains it.

For every fault that changes the expected readings (of the structure, or of a channel before noise) the right model without
it is fitted to readings free of noise, then once more with each candidate of `candidates` in its place. Chi-square that is left is
what noise would add to on average: a fault that leaves little cannot be seen; a candidate that leaves less than `SAME`
cannot be told from it, and counts as right too. `python benchmarks/accuracy/wrong_models.py --aliases` writes what is found to
aliases.json, which the cases read.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from wrong_models.assembly import STIFFNESSES, Table, assembled, count, sets, split
from wrong_models.faults import BEFORE_NOISE, STRUCTURAL, Fault, Readings, changed
from wrong_models.measuring import FREQUENCY_ERROR, LINES, SHAPE_ERROR, STATE_LINES, measured, noise_of
from wrong_models.rigs import Rig, Unknown, plain, properties
from wrong_models.study_files import Case

#: Chi-square below which a candidate cannot be told from the fault.
SAME = 9.0
#: Faults that this looks into.
SEEN = (*(kind for kind in STRUCTURAL if kind != "friction"), *BEFORE_NOISE, "direction", "damping_law")
#: Candidates of the linear screen that are fitted in full.
REFITTED = 8


def _whitened(made: Readings, like: Readings) -> np.ndarray:
    """Real rows in units of the noise of `like`."""
    if made.std is not None:
        sign = np.sign((made.motion * like.motion).sum(axis=1))[:, None]
        rows = [np.log(made.axis) / FREQUENCY_ERROR, (made.motion * sign / SHAPE_ERROR).ravel()]
        return np.concatenate(rows)
    scaled = (made.motion / noise_of(like.motion)).ravel() * np.sqrt(2 * LINES / STATE_LINES)
    return np.concatenate([scaled.real, scaled.imag])


def _readings(rig: Rig, table: Table, case: Case, faults: tuple[Fault, ...]) -> Readings:
    """Free of noise; FRFs have fewer lines, and histories stand as the FRFs that they hold."""
    other = {"frf2": "states2", "modal": "modal", "ambient": "modal", "shaken": "shaken", "quake": "shaken"}
    record = other.get(case.record, "states")
    return measured(rig, table, record, faults, np.random.default_rng(0), noisy=False)


class Examination:
    """The right model of a case as a function of the logarithms of its parameters, and a fault in it as one more number."""

    def __init__(self, case: Case) -> None:
        self.case, self.rig = case, case.measured_rig()
        faults = tuple(fault for fault in case.faults if fault.kind in SEEN)
        self.like = _readings(self.rig, changed(self.rig, faults), case, faults)
        self.data = _whitened(self.like, self.like)
        self.columns = [(one, i) for one in self.rig.unknowns for i in range(self._many(one))]

    def _many(self, one: Unknown) -> int:
        return count(properties(self.rig.table, one)[0][0]) if one.each else 1

    def table(self, logs: np.ndarray) -> Table:
        """The structure with parameters off by factors exp(`logs`)."""
        table = copy.deepcopy(self.rig.table)
        for (one, i), log in zip(self.columns, logs, strict=True):
            for own, key in properties(table, one):
                values = np.array(np.broadcast_to(own[key], count(own)), dtype=float)
                values[i if one.each else slice(None)] *= np.exp(log)
                own[key] = plain(values)
        return table

    def predicted(self, theta: np.ndarray, candidate: Candidate | None = None) -> np.ndarray:
        """Rows for parameters, and the strength of a candidate as the last entry where there is one."""
        n = len(self.columns)
        rig = replace(self.rig, table=self.table(theta[:n]))
        faults = () if candidate is None else (candidate.fault(float(theta[n])),)
        return _whitened(_readings(rig, changed(rig, faults), self.case, faults), self.like)

    def jacobian(self, theta: np.ndarray, base: np.ndarray, candidate: Candidate | None = None) -> np.ndarray:
        steps = 1e-5 * np.eye(len(theta))
        return np.stack([(self.predicted(theta + step, candidate) - base) / 1e-5 for step in steps], axis=1)

    def fitted(
        self, theta: np.ndarray, candidate: Candidate | None = None, steps: int = 40
    ) -> tuple[np.ndarray, float, np.ndarray]:
        """Parameters, chi-square and Jacobian at the nearest minimum (Levenberg-Marquardt)."""
        base, damping = self.predicted(theta, candidate), 1e-3
        chi = float(((self.data - base) ** 2).sum())
        slope = self.jacobian(theta, base, candidate)
        for _ in range(steps):
            normal, down = slope.T @ slope, slope.T @ (self.data - base)
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), down)
            step *= min(1.0, 0.5 / abs(step).max())
            try:
                tried = self.predicted(theta + step, candidate)
                value = float(((self.data - tried) ** 2).sum())
            except (np.linalg.LinAlgError, ValueError, OverflowError):
                value = np.inf
            if value < chi:
                theta, base, damping, gained, chi = theta + step, tried, damping / 5, chi - value, value
                if gained < 1e-3 * chi + 0.01:
                    break
                slope = self.jacobian(theta, base, candidate)
            else:
                damping *= 5
                if damping > 1e6:
                    break
        return theta, chi, slope


class Candidate:
    """A fault of one kind at one place as a function of its strength: exp(strength) times `unit`, or the strength itself."""

    def __init__(self, kind: str, where: str, unit: float, starts: tuple[float, ...], form: str = "{:.12g}") -> None:
        self.kind, self.where, self.unit, self.starts, self.form = kind, where, unit, starts, form

    def fault(self, strength: float) -> Fault:
        grows = self.kind in ("mass", "inertia", "delay", "direction")
        size = self.unit * strength if grows else self.unit * float(np.exp(strength))
        return Fault(self.kind, self.where, self.form.format(size))


def candidates(rig: Rig, case: Case) -> Iterator[Candidate]:
    """Everything of one number that might be wrong instead: structure and channels."""
    table, system = rig.table, assembled(rig.table)
    whole = assembled({**table, "fixed": []})
    stiff = dict(zip(whole.dofs, np.diag(whole.stiffness.real), strict=True))
    used, omega = system.dofs, 2 * np.pi * float(np.sqrt(rig.band[0] * rig.band[1]))
    total = float(sum(m for dof, m in zip(used, np.diag(system.mass), strict=True) if "R" not in dof))
    for dof in table["fixed"]:
        if stiff.get(dof, 0.0) > 0:
            yield Candidate("support", dof, stiff[dof], (2.0, 0.0, -2.0))
    for node in sorted({split(dof)[0] for dof in used}):
        yield Candidate("mass", str(node), total, (0.03, 0.003))
    for dof in used:
        if "R" in dof:
            yield Candidate("inertia", dof, stiff[dof] / omega**2, (0.03, 0.003))
        else:
            yield Candidate("dashpot", dof, total * omega, (-5.0, -8.0))
    for kind in ("beam", "space_beam"):
        for own in table.get(kind, ()):
            yield Candidate("shear", own["name"], 10 * stiff_of(own), (0.0, 2.0))
            for i, ends in enumerate(own["nodes"]):
                for node in ends:
                    for d in ("RX", "RY", "RZ"):
                        if f"{node}{d}" in used and d in table["active"]:
                            yield Candidate(
                                "joint", f"{own['name']}:{i + 1}/{node}{d}", stiff[f"{node}{d}"], (1.0, -1.0)
                            )
    for kind, own in sets(table):
        keys = (*STIFFNESSES.get(kind, ()), *(["mass"] if "mass" in own else []))
        for key in (k for k in keys if k in own):
            if count(own) > 1:
                for i in range(count(own)):
                    yield Candidate("untied", f"{own['name']}:{i + 1}", 1.0, (-0.2,), key + "*{:.12g}")
    for fault in case.faults:
        if fault.kind == "appendage":
            heavy, tuned = fault.size.split("@")
            for dof in used:
                if "R" not in dof:
                    yield Candidate("appendage", dof, float(heavy), (0.0,), "{:.12g}@" + tuned)
    modal = "modal" in case.record or case.record == "ambient"
    for label in rig.sensors:
        yield Candidate("sensor_gain", label, 1.0, (0.1,))
        if not modal:
            yield Candidate("delay", label, 0.1 / omega, (0.5,))
        for d in ("X", "Y", "Z"):
            if d in table["active"] and d not in label:
                yield Candidate("direction", label, 10.0, (1.0, 9.0), d + "@{:.12g}")
    if not modal:
        for label in rig.loads[: 2 if case.record == "frf2" else 1]:
            yield Candidate("load_gain", label, 1.0, (0.1,))


def stiff_of(own: dict[str, object]) -> float:
    """A shear stiffness scale of a set of beams: EI over a square metre."""
    key = "bending_stiffness" if "bending_stiffness" in own else "bending_stiffness_y"
    return float(np.mean(own[key]))  # type: ignore[arg-type]


def _is_same(candidate: Candidate, faults: tuple[Fault, ...]) -> bool:
    return any(candidate.kind == fault.kind and candidate.where == fault.where for fault in faults)


def told_apart(case: Case) -> dict[str, object]:
    """Chi-square that the fault leaves, largest bias in standard deviations and in parts, and the aliases of a single fault."""
    own = Examination(case)
    theta, chi, slope = own.fitted(np.zeros(len(own.columns)))
    covariance = np.linalg.inv(slope.T @ slope)
    bias = abs(theta) / np.sqrt(np.diag(covariance))
    aliases = []
    if len(case.faults) == 1 and not case.harmless:
        ranked = sorted(_screened(own, theta, case), key=lambda pair: pair[0])
        for _, candidate, start, begun in ranked[:REFITTED]:
            _, left, _ = own.fitted(np.append(begun, start), candidate, 12)
            place = [candidate.kind, _place(candidate)]
            if left < SAME and place not in aliases:
                aliases.append(place)
    return {
        "chi_square": float(f"{chi:.3g}"), "bias_std": float(f"{bias.max():.3g}"),
        "bias": float(f"{np.expm1(abs(theta)).max():.3g}"), "aliases": aliases,
    }  # fmt: skip


def _place(candidate: Candidate) -> str:
    """What a cause must name: element and node of a joint, degree of freedom, node, element, set."""
    if candidate.kind == "joint":
        element, dof = candidate.where.split("/")
        return f"{element} {split(dof)[0]}"
    return candidate.where


def _screened(own: Examination, theta: np.ndarray, case: Case) -> Iterator[tuple[float, Candidate, float, np.ndarray]]:
    """Chi-square left by one linear step along each candidate, from the fit and from the truth; the best start of each."""
    points = []
    for at in (theta, np.zeros_like(theta)):
        base = own.predicted(at)
        points.append((at, base, np.linalg.qr(own.jacobian(at, base))[0]))
    for candidate in candidates(own.rig, case):
        if _is_same(candidate, case.faults):
            continue
        best: list[tuple[float, Candidate, float, np.ndarray]] = []
        for at, base, q in points:
            rest = own.data - base
            rest = rest - q @ (q.T @ rest)
            for start in candidate.starts:
                try:
                    line = own.predicted(np.append(at, start), candidate) - base
                except (np.linalg.LinAlgError, ValueError):
                    continue
                line = line - q @ (q.T @ line)
                size = line @ line
                if size > 0:
                    best.append((float(rest @ rest - (line @ rest) ** 2 / size), candidate, start, at))
        if best:
            yield min(best, key=lambda one: one[0])


def can_look_into(case: Case) -> bool:
    """Whether all of its faults show in expected readings."""
    return bool(case.faults) and all(fault.kind in SEEN for fault in case.faults)
