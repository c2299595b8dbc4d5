"""Bands of predicted FRFs of a plate, and state equations of a larger one: how long beside one sweep of the model, how exact.

python benchmarks/prediction_speed.py [--size 17] [--lines 1000] [--outputs 50] [--draws 200] [--large 57]
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.prediction.identified_model import IdentifiedModel, identified_model


def plate(size: int, n_groups: int = 14) -> IdentifiedModel:
    """A steel plate of 1 m by 1 m with one edge clamped; stiffnesses by zone within 2 %, one loss factor within 20 %."""
    side = np.linspace(0.0, 1.0, size + 1)
    nodes = {j * (size + 1) + i: [x, y] for j, y in enumerate(side) for i, x in enumerate(side)}
    cells = [
        [j * (size + 1) + i, j * (size + 1) + i + 1, (j + 1) * (size + 1) + i + 1, (j + 1) * (size + 1) + i]
        for j in range(size)
        for i in range(size)
    ]
    groups = [list(part) for part in np.array_split(np.arange(len(cells)), n_groups)]
    sets = [
        sid.Plate(
            f"zone {k + 1}", [cells[c] for c in group], density=7850.0, youngs_modulus=2.1e11, thickness=0.004, poisson=0.3,
            loss_factor=0.01,
        )
        for k, group in enumerate(groups)
    ]  # fmt: skip
    fixed = [f"{node}{d}" for node in range(size + 1) for d in ("Z", "RX", "RY")]
    structure = sid.Structure(nodes, sets, fixed=fixed)
    names = [one.name for one in sets]
    unknown = [sid.Unknown("youngs_modulus", name) for name in names] + [sid.Unknown("loss_factor", names, name="all")]
    parameters = sid.parameters(structure, unknown)
    sizes = parameters.start * np.array([0.02] * n_groups + [0.2])
    return identified_model(structure, parameters, parameters.start, np.diag(sizes**2))


def record_of(quantity: sid.Frf) -> sid.FrfRecord:
    """A record of the channels and lines of FRFs, for the exact sweep beside them."""
    shape = (len(quantity.frequency), len(quantity.outputs), len(quantity.inputs))
    return sid.FrfRecord(
        quantity.frequency, np.zeros(shape, np.complex128), quantity.outputs, quantity.inputs, quantity.kind
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=17)
    parser.add_argument("--lines", type=int, default=1000)
    parser.add_argument("--outputs", type=int, default=50)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--large", type=int, default=57)
    chosen = parser.parse_args()
    model = plate(chosen.size)
    moving = [dof for dof in model.structure.dofs if dof.direction == "Z"]
    outputs = [moving[i] for i in np.linspace(0, len(moving) - 1, chosen.outputs).astype(int)]
    quantity = sid.Frf(outputs, [moving[-1]], np.linspace(2.0, 120.0, chosen.lines))
    from structid.forward.frf.response import response

    begun = time.process_time()
    exact = response(model.structure, model.parameters, record_of(quantity)).values_at(model.physical)
    sweep = time.process_time() - begun
    begun = time.process_time()
    told = sid.predict(model, quantity, chosen.draws)
    spent = time.process_time() - begun
    print(
        f"{model.structure.n_dofs} degrees of freedom, {chosen.lines} lines, {len(outputs)} outputs, {model.parameters.n_params}"
        f" parameters, {chosen.draws} models: one sweep {sweep:.2f} s, bands {spent:.2f} s of processor, {spent / sweep:.1f} sweeps"
    )
    moved = model.draw_parameters(3, np.random.default_rng(1))
    around = [model.parameters_at(2.0 * unit) for unit in np.eye(model.factor.shape[1])[:12]]
    function = quantity.evaluator(model.structure, model.parameters, [model.physical, *around])
    worst = 0.0
    for physical in moved:
        true = response(model.structure, model.parameters, record_of(quantity)).values_at(physical)
        worst = max(worst, float(np.abs(function(physical) - true).max() / np.abs(true).max()))
    if not np.allclose(told.values, exact):
        raise SystemExit("the identified model is not computed exactly")
    print(f"largest error of the reduced model within the uncertainty: {100 * worst:.3f} % of the largest FRF")
    large = plate(chosen.large)
    moving = [dof for dof in large.structure.dofs if dof.direction == "Z"]
    begun = time.process_time()
    made = sid.state_space(large, [moving[-1], moving[len(moving) // 2]], [moving[-1]], (1.0, 40.0), order=20)
    spent = time.process_time() - begun
    hertz = np.abs(np.linalg.eigvals(made.a).imag) / (2 * np.pi)
    frequency = np.unique(np.concatenate([np.linspace(1.0, 40.0, 60), hertz[(hertz > 1.0) & (hertz < 40.0)]]))
    frf = sid.Frf(made.outputs, made.inputs, frequency)
    true = response(large.structure, large.parameters, record_of(frf)).values_at(large.physical)
    error = np.abs(made.frf(frequency) - true).max() / np.abs(true).max()
    print(
        f"state equations of {large.structure.n_dofs} degrees of freedom: {len(made.a)} states in {spent:.1f} s, stated error"
        f" {100 * made.error:.3f} %, on {len(frequency)} lines with the resonances {100 * error:.3f} %"
    )


if __name__ == "__main__":
    main()
