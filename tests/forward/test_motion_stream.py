"""Motion by chunks from disk: the answer of the whole record, resumed, merged, in little memory."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from motion_cases import EVERYTHING, cantilever, frame, moved

from structid import FileError, InputError, PointMass, RigidLink, Spring, Status, Structure, TimeRecord, Unknown
from structid import parameters as declared
from structid.forward import identify_motion
from structid.forward.motion.fit import motion_fit
from structid.forward.motion.stream import (
    identify_motion_by_chunks,
    load_motion_fit,
    motion_solution,
    reduced_by_chunks,
    save_motion_fit,
)
from structid.inversion.regression.local_reduction import FoldingKernels, has_numba
from structid.records.formats import ReadOptions
from structid.records.on_disk import MemoryRecord, open_record

ENGINES = [FoldingKernels("numpy"), *([FoldingKernels("numba"), FoldingKernels("numba", 2)] if has_numba() else [])]
FIELDS = ("acceleration", "velocity", "displacement", "force")


def recorded(structure, n=60, noise=0.02, seed=3, **options):
    """A record of all motions and forces, channels shuffled and some of them turned round, with noisy forces."""
    motion, rng = moved(structure, n=n, **options), np.random.default_rng(seed)
    values = np.concatenate([getattr(motion, name) for name in FIELDS], axis=1)
    values[:, -structure.n_dofs :] += noise * rng.standard_normal(motion.force.shape) * motion.force.std()
    order, sign = rng.permutation(values.shape[1]), rng.choice([-1, 1], values.shape[1])
    names = [dof for _ in FIELDS for dof in structure.dofs]
    kinds = np.repeat(FIELDS, structure.n_dofs)
    channels = tuple(replace(names[i], sign=int(s)) for i, s in zip(order, sign, strict=True))
    return TimeRecord(20.0, values[:, order] * sign, channels, tuple(kinds[order].tolist()))


def on_disk(folder, record, name="record.npy"):
    np.save(folder / name, record.values)
    channels = tuple(str(dof) for dof in record.channels)
    return open_record(folder / name, ReadOptions(sampling_rate=20.0, channels=channels, quantities=record.quantities))


@pytest.mark.parametrize("work", ENGINES)
@pytest.mark.parametrize("longest", [None, 1, 17])
def test_chunks_from_disk_give_the_answer_of_the_whole_record(tmp_path, work, longest):
    """Values to 1e-10, deviations to 1e-9: cantilever with every mass, damping and stiffness unknown."""
    structure = cantilever()
    unknown = declared(structure, EVERYTHING)
    record = recorded(structure)
    expected = identify_motion(structure, unknown, record)
    told = []
    found = identify_motion_by_chunks(
        structure, unknown, on_disk(tmp_path, record), None, work, longest, progress=lambda *p: told.append(p)
    )
    assert found.values == pytest.approx(expected.values, rel=1e-10)
    assert found.std == pytest.approx(expected.std_noise, rel=1e-9)
    some = np.array([0, 5, 11])
    assert found.covariance(some) == pytest.approx(expected.spread.covariance_noise[np.ix_(some, some)], rel=1e-7)
    assert found.status is expected.status is Status.CONVERGED
    assert told[-1] == (60, 60)
    assert ("numba" in found.message) == (work.engine == "numba")
    assert found.fit.condition == pytest.approx(expected.identifiability.condition, rel=10)


def test_large_frame_and_rows_of_one_block_agree(tmp_path, monkeypatch):
    import structid.forward.motion.equations as module

    structure = frame()
    names = ("mass", "bending_stiffness_y", "bending_stiffness_z", "axial_stiffness", "mass_damping")
    unknown = declared(structure, [Unknown(name, "frame", each=True) for name in names])
    record = recorded(structure, n=80, rate=2000.0, loads=(0, 4, 7, 9, 14, 20))
    weights = np.linspace(0.5, 2, structure.n_dofs)
    expected = identify_motion(structure, unknown, record, row_weights=weights)
    found = identify_motion_by_chunks(structure, unknown, MemoryRecord(record), weights, longest=13)
    monkeypatch.setattr(module, "_STATE_ENTRIES", 0)
    single = identify_motion_by_chunks(structure, unknown, MemoryRecord(record), weights, longest=13)
    for other in (found, single):
        assert other.values == pytest.approx(expected.values, rel=1e-9)
        assert other.std == pytest.approx(expected.std_noise, rel=1e-8)


def test_parts_reduced_apart_and_merged_are_one_pass():
    """Seeded cuts in three, merged in any order: 1e-12 of one pass."""
    structure = cantilever()
    unknown, record = declared(structure, EVERYTHING), MemoryRecord(recorded(structure, n=90))
    empty = motion_fit(structure, unknown)
    whole = motion_solution(reduced_by_chunks(empty, structure, record))
    rng = np.random.default_rng(8)
    for _ in range(10):
        a, b = sorted(rng.integers(0, 91, 2).tolist())
        parts = [reduced_by_chunks(empty, structure, record, first=i, last=j) for i, j in ((0, a), (a, b), (b, 90))]
        rng.shuffle(parts)
        found = motion_solution(parts[0].merged(parts[1]).merged(parts[2]))
        assert found.values == pytest.approx(whole.values, rel=1e-12)
        assert found.std == pytest.approx(whole.std, rel=1e-11)
        assert found.n_samples == 90


def test_interrupted_pass_goes_on_to_the_same_digits(tmp_path):
    structure = cantilever()
    unknown, record = declared(structure, EVERYTHING), on_disk(tmp_path, recorded(structure))
    expected = identify_motion_by_chunks(structure, unknown, record, longest=7)
    path = tmp_path / "state.npz"

    def stop(done, whole):
        if done > 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        identify_motion_by_chunks(structure, unknown, record, longest=7, checkpoint=path, progress=stop)
    kept = load_motion_fit(path, motion_fit(structure, unknown))
    assert kept.n_samples == 35
    done = []
    found = identify_motion_by_chunks(
        structure, unknown, record, longest=7, checkpoint=path, progress=lambda *p: done.append(p[0])
    )
    assert done[0] == 42
    assert np.array_equal(found.values, expected.values)
    assert np.array_equal(found.std, expected.std)
    assert [item.name for item in tmp_path.iterdir() if item.name.startswith(".")] == []


def test_record_that_shrinks_leaves_a_checkpoint_to_go_on_from(tmp_path):
    structure = cantilever()
    unknown, full = declared(structure, EVERYTHING), recorded(structure)
    record, path = on_disk(tmp_path, full), tmp_path / "state.npz"

    def shrink(done, whole):
        if done == 21:
            np.save(tmp_path / "record.npy", full.values[:25])

    with pytest.raises(FileError, match=r"had 60 samples, and has 25 at sample 21.*resume from sample 21"):
        identify_motion_by_chunks(structure, unknown, record, longest=7, checkpoint=path, progress=shrink)
    again = on_disk(tmp_path, full)
    found = identify_motion_by_chunks(structure, unknown, again, longest=7, checkpoint=path)
    assert np.array_equal(found.values, identify_motion_by_chunks(structure, unknown, again, longest=7).values)


def test_checkpoint_of_another_study_or_damaged_is_refused(tmp_path):
    structure = cantilever()
    unknown, path = declared(structure, EVERYTHING), tmp_path / "state.npz"
    fit = motion_fit(structure, unknown)
    fit = reduced_by_chunks(fit, structure, MemoryRecord(recorded(structure)))
    save_motion_fit(path, fit)
    same = load_motion_fit(path, motion_fit(structure, unknown))
    assert np.array_equal(same.state.triangles, fit.state.triangles)
    assert (same.n_samples, same.state.n_rows) == (60, fit.state.n_rows)
    for other in (
        motion_fit(structure, unknown, np.full(8, 2.0)),
        motion_fit(structure, declared(structure, EVERYTHING[:2])),
    ):
        with pytest.raises(FileError, match="another structure, other parameters or other weights"):
            load_motion_fit(path, other)
    data = path.read_bytes()
    for damaged in (data[: len(data) // 2], b"not a zip file"):
        path.write_bytes(damaged)
        with pytest.raises(FileError, match=r"not a whole checkpoint .*; delete it to begin anew"):
            load_motion_fit(path, motion_fit(structure, unknown))


def test_undetermined_parameters_are_named():
    """The tip mass moves only where the base does not let it: a still mass is not seen, the others are right."""
    parts = [PointMass("mass", [1, 2], [2.0, 3.0]), Spring("spring", ["1X"], ["2X"], stiffness=5.0)]
    structure = Structure({1: 0.0, 2: 1.0}, [*parts, Spring("base", "1X", stiffness=7.0)], active=["X"])
    unknown = declared(structure, [Unknown("mass", "mass", each=True), Unknown("stiffness", ["base"])])
    record = recorded(structure)
    still = np.array(
        [q == "acceleration" and c.node == 2 for q, c in zip(record.quantities, record.channels, strict=True)]
    )
    silent = replace(record, values=np.where(still, 0.0, record.values))
    found = identify_motion_by_chunks(structure, unknown, MemoryRecord(silent))
    assert np.isnan(found.values).tolist() == [False, True, False]
    assert found.status is Status.NOT_IDENTIFIABLE
    assert "not seen: mass[mass:2]: these masses do not accelerate" in found.message


def test_tied_and_repeated_channels_are_averaged():
    parts = [PointMass("mass", [1], 2.0), Spring("base", "1X", stiffness=7.0), PointMass("far", [2], 1.0)]
    structure = Structure({1: 0.0, 2: 1.0}, parts, ties=[RigidLink("link", 1, 2)], active=["X"])
    unknown = declared(structure, [Unknown("mass", "mass"), Unknown("stiffness", "base")])
    rng = np.random.default_rng(0)
    values = rng.standard_normal((50, 5))
    names = ("1X", "2X-", "1X", "2X", "2X")
    record = TimeRecord(20.0, values, names, ("acceleration",) * 2 + ("displacement",) * 2 + ("force",))
    expected = identify_motion(structure, unknown, record)
    found = identify_motion_by_chunks(structure, unknown, MemoryRecord(record), longest=9)
    assert found.values == pytest.approx(expected.values, rel=1e-11)


BAD = {
    "no motion": (lambda r: ["force"], "holds no motion"),
    "no force": (lambda r: FIELDS[:3], "no force channel"),
    "no velocity": (lambda r: ("acceleration", "displacement", "force"), "velocity is missing, and the structure has"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_the_record_lacks_is_named(case):
    keep, words = BAD[case]
    structure = cantilever()
    record = recorded(structure)
    chosen = np.flatnonzero([name in keep(record) for name in record.quantities])
    part = TimeRecord(
        20.0, record.values[:, chosen], [record.channels[i] for i in chosen], [record.quantities[i] for i in chosen]
    )
    with pytest.raises(InputError, match=words):
        identify_motion_by_chunks(structure, declared(structure, EVERYTHING), MemoryRecord(part))


def test_unmeasured_degrees_of_freedom_are_named():
    structure = cantilever()
    record = recorded(structure)
    kept = [
        i
        for i, (q, c) in enumerate(zip(record.quantities, record.channels, strict=True))
        if (q, c.node) != (FIELDS[1], 2)
    ]
    part = TimeRecord(
        20.0, record.values[:, kept], [record.channels[i] for i in kept], [record.quantities[i] for i in kept]
    )
    with pytest.raises(InputError, match=r"velocity is not measured at 2Y\+, 2RZ\+; identification from motion"):
        identify_motion_by_chunks(structure, declared(structure, EVERYTHING), MemoryRecord(part))


MEMORY = """
import ctypes, gc, sys, threading, time
import numpy as np
from structid import Beam, Structure, Unknown, parameters
from structid.inversion.regression.local_reduction import FoldingKernels
from structid.forward import motion_fit
from structid.forward.motion.stream import motion_solution, reduced_by_chunks
from structid.records.formats import ReadOptions
from structid.records.on_disk import open_record
n, path = 500, sys.argv[1]
beam = Beam("beam", np.stack([np.arange(n), np.arange(1, n + 1)], axis=1), 1.0, 1.0, mass_damping=1.0)
structure = Structure({i: float(i) for i in range(n + 1)}, [beam], ["0Y", "0RZ"], active=["Y", "RZ"])
unknown = parameters(structure, [Unknown(p, "beam", each=True) for p in ("mass", "mass_damping", "bending_stiffness")])
names = tuple(str(dof) for dof in structure.dofs)
kinds = tuple(np.repeat(["acceleration", "velocity", "displacement", "force"], len(names)).tolist())
record = open_record(path, ReadOptions(sampling_rate=1.0, channels=names * 4, quantities=kinds))
fit, work = motion_fit(structure, unknown), FoldingKernels(sys.argv[2])
motion_solution(reduced_by_chunks(fit, structure, record, work, longest=40, last=80), work)
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096
gc.collect()
ctypes.CDLL(None).malloc_trim(0)  # what the trial left behind does not count as there before
before, peak, done = resident(), [0], threading.Event()
def watch():
    while not done.is_set():
        peak[0] = max(peak[0], resident())
        time.sleep(0.001)
thread = threading.Thread(target=watch); thread.start()
motion_solution(reduced_by_chunks(fit, structure, record, work, longest=40), work)
done.set(); thread.join()
print(peak[0] - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads the resident memory from /proc")
@pytest.mark.parametrize("work", ENGINES[:2])
def test_memory_beyond_the_record_stays_below_a_tenth_of_it(tmp_path, work):
    """Measured in a process of its own, as resident memory: 500 beams, 3000 samples, 96 MB."""
    rng = np.random.default_rng(0)
    values = np.lib.format.open_memmap(tmp_path / "long.npy", "w+", np.float64, (3000, 4000))
    for first in range(0, 3000, 500):
        values[first : first + 500] = rng.standard_normal((500, 4000))
    values.flush()
    command = [sys.executable, "-c", MEMORY, str(tmp_path / "long.npy"), work.engine]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) <= 0.1 * 96e6
