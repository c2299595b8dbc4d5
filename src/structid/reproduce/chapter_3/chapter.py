"""Chapter 3, identification in the time domain: Tables 3.1 to 3.4, Figures 3.1 and 3.2, and what the text claims.

References
----------
Norris (1986), chapter 3.
"""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray
from structid.dynamics.normal_modes import modes
from structid.fem import Structure
from structid.forward.motion.fit import motion_fit
from structid.reproduce.chapter_3.data import (
    ACTUAL,
    ESTIMATED,
    FORCED_NODE,
    FREQUENCIES,
    MASS_SHAPE,
    N_ELEMENTS,
    STIFFNESS_SHAPE,
    beam,
    driven,
    sampling_times,
    unknown_values,
)
from structid.reproduce.chapter_3.noise import claims, noisy_table
from structid.reproduce.item import Curve, Panel, Progress, ReproducedItem, Step, Table, Verdict, made, unprinted

#: Seeds 0, 1, ... of the random studies of Tables 3.2 and 3.3.
N_SEEDS = 500
_SAMPLES = (1, 2, 4, 8, 64, 256)
_HALF_A_DIGIT = 5e-7


def items(progress: Progress | None = None, n_seeds: int = N_SEEDS) -> tuple[ReproducedItem, ...]:
    """Tables 3.1 to 3.4 and Figures 3.1 and 3.2 beside what is printed, and the text's claims on noise.

    Random studies use the seeds 0 to n_seeds - 1, those of long records fewer, as their notes state. `progress` is called with
    the name of an item and the fraction done.
    """
    steps: tuple[Step, ...] = (
        (0.0, "Table 3.1", lambda _: [table_3_1()]),
        (0.05, "Table 3.2", lambda _: [noisy_table("Table 3.2", 4, n_seeds)]),
        (0.2, "Table 3.3", lambda _: [noisy_table("Table 3.3", 8, n_seeds)]),
        (0.4, "Table 3.4", lambda _: [table_3_4(), figure_3_1(), figure_3_2()]),
        (0.45, "Claims on noise", lambda report: [claims(n_seeds, report)]),
    )
    return made(steps, progress)


def table_3_1() -> ReproducedItem:
    """Table 3.1: the 30 parameters of the beam, identified from exact motion; with damping 45 parameters."""
    rows, results = [], []
    for label, damping in _dampings().items():
        structure = beam(ACTUAL, damping)
        for n_samples in _SAMPLES:
            if damping and n_samples == 1:
                continue  # 32 equations for 45 parameters
            error, condition, values = _identify_noise_free(structure, tuple(damping), n_samples)
            rows.append(f"{label}, m = {n_samples}")
            results.append([len(values), error, condition])
            if label == "undamped" and n_samples == 2:
                computed = values
    errors = np.array([row[1] for row in results])
    agrees = errors[1 : len(_SAMPLES)].max() < 1e-11 and errors[len(_SAMPLES) :].max() < 1e-10
    columns = ("mass m (kg/m)", "stiffness k (N/m)")
    supporting = ("parameters", "largest relative error", "condition, unit columns")
    return ReproducedItem(
        "Table 3.1",
        "Mass and stiffness distributions of the free-free beam",
        Verdict.AGREES if agrees else Verdict.REFUTED,
        "Computed are the 30 parameters identified from the exact transient motion at two instants, 0.5 and 1 s, with"
        " no start and no iteration. Without noise they come back to 1e-11 from two samples on, and the 45 parameters"
        " with damping to 1e-10; one sample suffices for the 30 but is ill conditioned."
        "\nUnits: m is printed in kg; it is mass per length, kg/m, since Eq. (3.19b) carries the length h. With h = 1 m"
        " the numbers are the same, and k = EI / h^3 equals EI.",
        tables=(
            Table(_elements(), columns, ACTUAL.reshape(2, -1).T, computed.reshape(2, -1).T),
            unprinted(tuple(rows), supporting, np.array(results)),
        ),
    )


def _dampings() -> dict[str, dict[str, FloatArray]]:
    """Damping properties of the beam by a label: none, two strain-rate dampings and a viscous damping.

    Each is a dict of keyword arguments of `Beam`, (15,) each.
    """
    mass, stiffness = ACTUAL[:N_ELEMENTS], ACTUAL[N_ELEMENTS:]
    uneven = 1 + 0.3 * np.sin(np.arange(1, N_ELEMENTS + 1))
    return {
        "undamped": {},
        "strain-rate damping 0.001 k, uneven by 30 %": {"stiffness_damping": 1e-3 * stiffness * uneven},
        "strain-rate damping 0.02 k": {"stiffness_damping": 2e-2 * stiffness},
        "viscous damping 0.05 m": {"mass_damping": 0.05 * mass},
    }


def _identify_noise_free(
    structure: Structure, damping: tuple[str, ...], n_samples: int
) -> tuple[float, float, FloatArray]:
    """Largest relative error, condition number and values (n_params,) of the parameters identified from exact motion.

    The motion is sampled at `n_samples` instants; `damping` names the damping properties that are parameters too.
    """
    unknown = unknown_values(structure, *damping)
    motion = driven(structure, sampling_times(n_samples), bool(damping))
    solution = motion_fit(structure, unknown).updated(motion).solution()
    return float(np.abs(solution.values / unknown.start - 1).max()), solution.condition, solution.values


def table_3_4() -> ReproducedItem:
    """Table 3.4: natural frequencies (rad/s) from the parameters of Tables 3.1 and 3.2, and their relative differences."""
    actual, estimated = natural_frequencies(ACTUAL), natural_frequencies(ESTIMATED[4])
    relative = np.full(10, np.nan)
    relative[2:] = estimated[2:] / actual[2:] - 1
    computed = np.column_stack([actual, estimated, relative])
    difference = np.abs(computed - FREQUENCIES)
    wrong = np.flatnonzero(np.nan_to_num(difference[:, 2]) > 3e-5) + 1
    as_stated = difference[:, 0].max() <= _HALF_A_DIGIT and difference[:, 1].max() <= 3.5e-6 and wrong.tolist() == [6]
    other = np.abs(natural_frequencies(ESTIMATED[8]) - FREQUENCIES[:, 1]).max()
    columns = ("actual (rad/s)", "estimated (rad/s)", "relative error")
    return ReproducedItem(
        "Table 3.4",
        "First ten natural frequencies of the free-free beam",
        Verdict.MISPRINT if as_stated else Verdict.REFUTED,
        "The actual frequencies follow from Table 3.1 to all six printed decimals. The estimated ones follow from"
        f" Table 3.2, m = 4, to {difference[:, 1].max():.1e}, as far as its four decimals allow; Table 3.3, m = 8,"
        f" misses them by up to {other:.1g} rad/s. Correction at r = 6: the relative error is"
        f" {relative[5]:.6f}, one decimal place below the printed 0.004044; the frequencies in the same line say so too."
        "\nThe relative error is printed in rad/s; it has no unit.",
        tables=(Table(tuple(f"r = {r}" for r in range(1, 11)), columns, FREQUENCIES, computed),),
    )


def natural_frequencies(values: FloatArray) -> FloatArray:
    """Ten lowest natural frequencies of the beam with parameters `values` (30,), in rad/s; rigid-body modes at 0."""
    structure = beam(values)
    found = 2 * np.pi * modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=10).frequency
    return np.where(found < 1e-5, 0.0, found)


def figure_3_1() -> ReproducedItem:
    """Figure 3.1: sizes of the finite element model as a table, and its distributions of mass and stiffness as panels."""
    structure = beam(ACTUAL)
    positions = np.array([float(x[0]) for x in structure.nodes.values()])
    sizes = [
        len(structure.elements[0].nodes),
        len(positions),
        structure.n_dofs,
        np.ptp(positions),
        structure.nodes[FORCED_NODE][0],
        unknown_values(structure).n_params,
    ]
    columns = ("elements N", "nodes", "degrees of freedom n", "length L (m)", "x of node 7 (m)", "parameters")
    printed, computed = np.array([[15.0, 16, 32, 15, 6, 30]]), np.array([sizes], dtype=np.float64)
    x = np.repeat(positions, 2)[1:-1]
    force = Curve("force 0.1 cos t N at node 7", np.full(2, structure.nodes[FORCED_NODE][0]), np.array([0.0, 9.0]))
    mass = Curve("mass", x, np.repeat(ACTUAL[:N_ELEMENTS], 2))
    stiffness = Curve("stiffness", x, np.repeat(ACTUAL[N_ELEMENTS:], 2))
    return ReproducedItem(
        "Figure 3.1",
        "The finite element model",
        Verdict.AGREES if np.array_equal(printed, computed) else Verdict.REFUTED,
        "The drawing itself is not available and was not compared. What the text says of it is: the sizes of the"
        " model, and the structural properties, which the panels draw from Table 3.1, constant along each element.",
        tables=(Table(("model",), columns, printed, computed),),
        panels=(
            Panel("Mass distribution", "distance along the beam (m)", "mass per length (kg/m)", (mass, force)),
            Panel("Stiffness distribution", "distance along the beam (m)", "EI / h^3 (N/m)", (stiffness,)),
        ),
    )


def figure_3_2() -> ReproducedItem:
    """Figure 3.2: interpolation functions of the beam element, and the element matrices integrated from them."""
    points, weights = np.polynomial.legendre.leggauss(6)
    xi, weights = 0.5 * (points + 1), 0.5 * weights
    shapes = hermite(xi)
    curvatures = np.array([6 - 12 * xi, 2 - 6 * xi, -6 + 12 * xi, 4 - 6 * xi])
    computed = np.concatenate([420 * (shapes * weights) @ shapes.T, (curvatures * weights) @ curvatures.T])
    printed = np.concatenate([MASS_SHAPE, STIFFNESS_SHAPE])
    rows = tuple(f"{name}, row {i}" for name in ("420/h Phi_M", "Phi_K") for i in range(1, 5))
    x = np.linspace(0, 1, 101)
    labels = ("w at the left node", "h theta at the left node", "w at the right node", "h theta at the right node")
    curves = tuple(Curve(label, x, y) for label, y in zip(labels, hermite(1 - x), strict=True))
    return ReproducedItem(
        "Figure 3.2",
        "A typical finite element showing nodal displacements",
        Verdict.AGREES if np.abs(printed - computed).max() < 1e-10 else Verdict.REFUTED,
        "The drawing itself is not available and was not compared. The panel shows the interpolation functions (3.17)"
        " of its four nodal displacements, with xi = j - x/h. Integrated by quadrature they give the printed element"
        " matrices (3.19b) and (3.20b). In the text after (3.18), j of w_j and theta_j numbers the nodes, 0 to N, not"
        " the elements; 3.19a as read repeats the second function as the third.",
        tables=(Table(rows, tuple(f"column {j}" for j in range(1, 5)), printed, computed),),
        panels=(Panel("Interpolation functions", "(x - (j-1) h) / h", "displacement", curves),),
    )


def hermite(xi: FloatArray) -> FloatArray:
    """Interpolation functions of Eq. (3.17) at the points `xi` (n_points,), (4, n_points)."""
    return np.array(
        [3 * xi**2 - 2 * xi**3, xi**2 - xi**3, 1 - 3 * xi**2 + 2 * xi**3, -xi + 2 * xi**2 - xi**3], dtype=np.float64
    )


def _elements() -> tuple[str, ...]:
    return tuple(f"element {i}" for i in range(1, N_ELEMENTS + 1))
