"""Chapter 4, the perturbation technique: Table 4.1 and Figures 4.1 to 4.5.

References
----------
Norris (1986), chapter 4.
"""

from __future__ import annotations

import numpy as np

from structid.arrays import FloatArray
from structid.reproduce.chapter_4.cantilever import (
    ALL_MOTIONS,
    CASE_1,
    CASE_2,
    GRID,
    N_ELEMENTS,
    SYMBOLS,
    TIP,
    Case,
    Reading,
    cantilever,
    classical_values,
    exact_record,
    in_rad_per_s,
    one_step_solution,
    unknowns,
)
from structid.reproduce.chapter_4.exact import figure_4_2, figure_4_3
from structid.reproduce.chapter_4.noise import figure_4_4, figure_4_5
from structid.reproduce.item import Curve, Item, Panel, Progress, Table, Verdict

#: Seeds 0, 1, ... of the random studies.
N_SEEDS = 200


def items(progress: Progress | None = None, n_seeds: int = N_SEEDS) -> tuple[Item, ...]:
    """Table 4.1 and Figures 4.1 to 4.5, computed beside what is printed.

    Parameters
    ----------
    progress : callable, optional
        Called with the item in work and the part of the chapter that is done.
    n_seeds : int
        Random studies use the seeds 0 to n_seeds - 1.
    """

    def report(name: str, done: float) -> None:
        if progress is not None:
            progress(name, done)

    found = []
    report("Table 4.1", 0.0)
    found += [table_4_1(), figure_4_1()]
    report("Figure 4.2", 0.01)
    found.append(figure_4_2())
    report("Figure 4.3", 0.02)
    found.append(figure_4_3())
    found.append(figure_4_4(range(n_seeds), lambda part: report("Figure 4.4", 0.04 + 0.51 * part)))
    found.append(figure_4_5(range(n_seeds), lambda part: report("Figure 4.5", 0.55 + 0.45 * part)))
    report("Figure 4.5", 1.0)
    return tuple(found)


def table_4_1() -> Item:
    """The actual parameters, identified again from the postulated ones."""
    all_motions = exact_record(CASE_1.actual, Reading("", in_rad_per_s(GRID[0]), ALL_MOTIONS))
    tip_in_hz = exact_record(CASE_2.actual, Reading("", GRID, (TIP,)))
    computed = np.column_stack(
        [
            classical_values(CASE_1, all_motions, 6)[-1],
            one_step_solution(CASE_1, all_motions),
            classical_values(CASE_2, tip_in_hz, 6)[-1],
        ]
    )
    printed = np.column_stack([CASE_1.actual, CASE_1.actual, CASE_2.actual])
    columns = ("Case 1, classical iteration", "Case 1, one linear solve", "Case 2, classical iteration, Hz")
    found = np.abs(computed / printed - 1).max() < 1e-10
    start = np.column_stack(
        [CASE_1.postulated, 100 * CASE_1.relative_error, CASE_2.postulated, 100 * CASE_2.relative_error]
    )
    given = start.copy()
    given[:, [1, 3]] = np.nan
    headings = ("Case 1, postulated", "error (%)", "Case 2, postulated", "error of it (%)")
    return Item(
        "Table 4.1",
        "Actual and postulated parameters for cases 1 and 2",
        Verdict.READING if found else Verdict.REFUTED,
        "The actual parameters come back from the postulated ones to rounding: in case 1 from all twelve motions at"
        " 0.5 rad/s, by the classical iteration and, with no postulated model at all, by one linear solve with the"
        " measured motion in the regressor; in case 2 from one transverse sensor at the tip only if the twelve"
        " frequencies are read in Hz (see Figure 4.3). Units: what is printed in kg is mass per length, kg/m; the"
        " stiffnesses are k = EI / h^3 in N/m, equal to EI since the elements have h = 1 m.",
        tables=(Table(_rows(), columns, printed, computed), Table(_rows(), headings, given, start)),
    )


def _rows() -> tuple[str, ...]:
    return tuple(f"{symbol} ({'kg/m' if symbol[0] == 'm' else 'N/m'})" for symbol in SYMBOLS)


def figure_4_1() -> Item:
    """The finite element model: its sizes, and its distributions of mass and stiffness."""
    structure = cantilever(CASE_1.actual)
    length = float(structure.nodes[N_ELEMENTS][0])
    rows = ("elements N", "free nodes", "degrees of freedom n", "length L (m)", "parameters")
    free_nodes = len({dof.node for dof in structure.dofs})
    computed = np.array(
        [[N_ELEMENTS], [free_nodes], [structure.n_dofs], [length], [unknowns(structure).n_params]], dtype=np.float64
    )
    panels = [
        Panel(title, "distance from the clamped end (m)", label, _distributions(part))
        for title, label, part in (
            ("Mass distribution", "mass per length (kg/m)", slice(0, N_ELEMENTS)),
            ("Stiffness distribution", "EI / h^3 (N/m)", slice(N_ELEMENTS, None)),
        )
    ]
    printed = np.array([[6.0], [6.0], [12.0], [6.0], [12.0]])
    return Item(
        "Figure 4.1",
        "Finite element model of a structure",
        Verdict.AGREES if np.array_equal(computed, printed) else Verdict.REFUTED,
        "The drawing itself is not available; its model is the cantilever of six Hermite beam elements that the text"
        " describes, loaded transversely at the free end. The panels show the distributions of Table 4.1, constant"
        " along each element.",
        tables=(Table(rows, ("model",), printed, computed),),
        panels=tuple(panels),
    )


def _distributions(part: slice) -> tuple[Curve, ...]:
    """Actual and postulated values of both cases as steps along the beam."""
    x = np.repeat(np.arange(N_ELEMENTS + 1.0), 2)[1:-1]

    def step(values: FloatArray) -> FloatArray:
        return np.repeat(values[part], 2)

    def pair(case: Case) -> tuple[Curve, Curve]:
        return (
            Curve(f"{case.name}, actual", x, step(case.actual)),
            Curve(f"{case.name}, postulated", x, step(case.postulated)),
        )

    return (*pair(CASE_1), *pair(CASE_2))
