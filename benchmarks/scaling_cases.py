"""One point of `scaling.py`: a case of one size prepared or measured, in a process of its own.

``python benchmarks/scaling_cases.py LAW SIZE FOLDER prepare`` writes the record to the folder where there is one on
disk; ``... measure`` prints processor time, peak of the resident memory, and its peak before the work, as JSON.
"""

from __future__ import annotations

import itertools
import json
import resource
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy import signal

import structid as sid
from structid.forward.motion.stream import identify_motion_by_chunks
from structid.inversion.regression.local_reduction import FoldingKernels
from structid.modal import ModalOptions, modal_identification
from structid.modal.full_field import shared_motions
from structid.records.on_disk import OnDiskRecord

RATE = 1000.0
PROPERTIES = ("mass", "mass_damping", "bending_stiffness")
TIME_SAMPLES, TIME_ELEMENTS = 100, 300
FRF_CELLS, FRF_LINES, FRF_SENSORS, FRF_GROUPS = (64, 32), 4, 20, 10
PARAMETER_CELLS = (160, 80)
MODAL_CHANNELS, MODAL_SAMPLES, FIELD_SAMPLES = 10, 20_000, 500
#: Below this many seconds a measurement is the median of three.
BRIEF = 1.0

Work = Callable[[], object]


def chain(n: int) -> tuple[sid.Structure, sid.Parameters]:
    """A cantilever of n beams, mass, damping and stiffness of each unknown."""
    beam = sid.Beam("beam", np.stack([np.arange(n), np.arange(1, n + 1)], axis=1), 1.0, 1.0, mass_damping=1.0)
    structure = sid.Structure({i: float(i) for i in range(n + 1)}, [beam], ["0Y", "0RZ"], active=["Y", "RZ"])
    return structure, sid.parameters(structure, [sid.Unknown(p, "beam", each=True) for p in PROPERTIES])


def motion_work(n: int, n_times: int, path: Path) -> Work:
    """The pass over a record on disk, and the solution."""
    structure, unknown = chain(n)
    quantities = np.repeat(["acceleration", "velocity", "displacement", "force"], structure.n_dofs).tolist()
    record = OnDiskRecord(path, "", structure.dofs * 4, tuple(quantities), RATE, n_times, True)
    return partial(identify_motion_by_chunks, structure, unknown, record, None, FoldingKernels("numba"))


def write_motion(n: int, n_times: int, path: Path) -> None:
    """White noise as motion and force: the work does not depend on the values."""
    rng = np.random.default_rng(0)
    values = np.lib.format.open_memmap(path, "w+", np.float64, (n_times, 8 * n))
    for first in range(0, n_times, 50):
        values[first : first + 50] = rng.standard_normal((min(50, n_times - first), 8 * n))
    values.flush()


def plate_work(cells: tuple[int, int], n_lines: int, n_params: int) -> Work:
    """Residual and Jacobian of the FRFs of a clamped plate in its plane, `n_params` groups of elements."""
    nx, ny = cells
    grid = np.stack(np.meshgrid(np.arange(nx + 1) / ny, np.arange(ny + 1) / ny, indexing="ij"), axis=-1)
    corner = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    table = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1).reshape(-1, 4)
    plate = sid.Plane("plate", table, 70e9, 2700.0, 0.01, 0.3, loss_factor=0.02)
    held = [f"{node}{direction}" for node in range(ny + 1) for direction in "XY"]
    structure = sid.Structure(dict(enumerate(grid.reshape(-1, 2))), [plate], held, active=["X", "Y"])
    ends = np.linspace(0, nx * ny, n_params + 1).astype(int)
    groups = [f"plate:{a + 1}-{b}" for a, b in itertools.pairwise(ends)]
    unknown = sid.parameters(structure, [sid.Unknown("youngs_modulus", group) for group in groups])
    free = structure.dofs[1::2]
    sensors = [free[i] for i in np.linspace(0, len(free) - 1, FRF_SENSORS).astype(int)]
    values = np.ones((n_lines, FRF_SENSORS, 1))
    frequency = np.linspace(50.0, 500.0, n_lines)
    record = sid.FrfRecord(frequency, values, sensors, sensors[-1:], "receptance", variance=np.abs(values))
    at = sid.FrfProblem(structure, unknown, record)
    return partial(at.linearize, at.theta_start)


def write_modal(n_channels: int, n_times: int, path: Path) -> None:
    """Five modes driven by white noise, and white noise of the channels."""
    rng, rate = np.random.default_rng(0), 100.0
    values = np.lib.format.open_memmap(path, "w+", np.float64, (n_times, n_channels))
    values[:] = 0.0
    for frequency in (3.0, 7.0, 12.0, 18.0, 25.0):
        pole = np.exp(2 * np.pi * frequency / rate * (-0.01 + 1j))
        motion = signal.lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], rng.standard_normal(n_times))
        shape = rng.standard_normal(n_channels)
        for channel in range(n_channels):
            values[:, channel] += shape[channel] * motion
    for channel in range(n_channels):
        values[:, channel] += 0.1 * values[:, channel].std() * rng.standard_normal(n_times)
    values.flush()


def modal_work(path: Path) -> Work:
    """Covariance-driven subspace identification with standard deviations."""
    values = np.load(path)
    n = values.shape[1]
    record = sid.TimeRecord(100.0, values, [f"{i + 1}Z" for i in range(n)], ["acceleration"] * n)
    return partial(modal_identification, record, "ssi_cov", ModalOptions(orders=range(10, 21, 2), block_rows=20))


def write_field(n_channels: int, path: Path) -> None:
    """Ten decaying modes of a line of channels and noise, single precision."""
    omega, at = np.linspace(2.0, 40.0, 10), np.arange(FIELD_SAMPLES)[:, None] * 0.02
    motion = np.exp(-0.01 * omega * at) * np.cos(omega * at)
    places = np.linspace(0.0, np.pi, n_channels)
    values = (motion @ np.sin(np.outer(np.arange(1, 11), places))).astype(np.float32)
    values += 0.01 * np.random.default_rng(0).standard_normal(values.shape, dtype=np.float32)
    np.save(path, values)


def field_work(path: Path) -> Work:
    """Shared motions of a full field, mapped from disk."""
    return partial(shared_motions, np.load(path, mmap_mode="r"), 10)


def square(n_elements: int) -> tuple[int, int]:
    """Cells of a plate twice as long as wide with about `n_elements`."""
    width = max(1, round((n_elements / 2) ** 0.5))
    return 2 * width, width


#: law -> (what writes its record, its work), each of size and path.
CASES: dict[str, tuple[Callable[[int, Path], object] | None, Callable[[int, Path], Work]]] = {
    "motion_elements": (lambda n, p: write_motion(n, TIME_SAMPLES, p), lambda n, p: motion_work(n, TIME_SAMPLES, p)),
    "motion_samples": (lambda m, p: write_motion(TIME_ELEMENTS, m, p), lambda m, p: motion_work(TIME_ELEMENTS, m, p)),
    "frf_elements": (None, lambda n, p: plate_work(square(n), FRF_LINES, FRF_GROUPS)),
    "frf_frequencies": (None, lambda m, p: plate_work(FRF_CELLS, m, FRF_GROUPS)),
    "frf_parameters": (None, lambda k, p: plate_work(PARAMETER_CELLS, FRF_LINES, k)),
    "modal_samples": (lambda m, p: write_modal(MODAL_CHANNELS, m, p), lambda m, p: modal_work(p)),
    "modal_channels": (lambda n, p: write_modal(n, MODAL_SAMPLES, p), lambda n, p: modal_work(p)),
    "field_channels": (lambda n, p: write_field(n, p), lambda n, p: field_work(p)),
}


def peak() -> int:
    """Largest resident memory so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def warmed(law: str, folder: Path) -> None:
    """Similar work at a tiny size: compiles kernels and loads libraries."""
    path = folder / f"{law}_tiny.npy"
    family = law.partition("_")[0]
    if family == "motion":
        write_motion(8, 32, path)
        motion_work(8, 32, path)()
    elif family == "frf":
        plate_work((8, 4), 2, 2)()
    elif family == "modal":
        write_modal(4, 2000, path)
        modal_work(path)()
    else:
        write_field(600, path)
        field_work(path)()


def measured(law: str, size: int, folder: Path) -> dict[str, float]:
    """Processor time of the work once or three times, and the memory that it took."""
    warmed(law, folder)
    before = peak()
    work = CASES[law][1](size, folder / f"{law}_{size}.npy")
    taken = []
    while len(taken) < (3 if not taken or taken[0] < BRIEF else 1):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return {"seconds": statistics.median(taken), "peak": peak(), "before": before, "runs": len(taken)}


def main() -> None:
    """Prepare or measure, as asked."""
    law, size, folder, step = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), sys.argv[4]
    prepare = CASES[law][0]
    if step == "measure":
        print(json.dumps(measured(law, size, folder)))
    elif prepare is not None:
        prepare(size, folder / f"{law}_{size}.npy")


if __name__ == "__main__":
    main()
