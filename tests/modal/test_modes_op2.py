"""Binary results of Nastran, written here record by record in every form that the format allows."""

import random

import numpy as np
import pytest
from fuzz.binary_results import Writer

from structid.core.errors import FileError
from structid.external.outputs import ModesOut, RunDeck
from structid.modal.formats.files import read_modes
from structid.modal.formats.options import ModeFileOptions

POINTS = [1, 7, 99999999]


def case(seed):
    """A file of real or complex modes, its frequencies, damping ratios, shapes (18, n) and generalized masses."""
    rng, noise = random.Random(seed), np.random.default_rng(seed)
    writer = Writer(rng.choice("<>"), rng.choice((4, 8)), rng.random() < 0.7)
    count, is_complex, polar = rng.randint(1, 4), rng.random() < 0.4, rng.random() < 0.5
    frequency = np.sort(noise.uniform(1, 90, count))
    ratio = noise.uniform(0.001, 0.05, count) if is_complex else np.full(count, np.nan)
    shapes = noise.standard_normal((count, 3, 6)) + 1j * is_complex * noise.standard_normal((count, 3, 6))
    masses = noise.uniform(0.5, 9, count)
    scalars = rng.sample(range(200, 300), rng.choice((0, 2)))
    name = rng.choice(("OUGV1", "OUG1", "OPHIG", "BOUGV1"))
    parts = []
    for k in rng.sample(range(count), count):
        omega = 2 * np.pi * frequency[k]
        if is_complex:
            first, second = -ratio[k] * omega, omega * np.sqrt(1 - ratio[k] ** 2)
            pair = (np.abs(shapes[k]), np.degrees(np.angle(shapes[k]))) if polar else (shapes[k].real, shapes[k].imag)
            values = np.concatenate(pair, axis=1)
        else:
            first, second, values = omega**2, 0.0, shapes[k].real
        head = writer.heading(9 if is_complex else 2, 1007 if is_complex else 7, 1, k + 1, float(first), float(second),
                              (3 if polar else 2) if is_complex else 1, 14 if is_complex else 8)  # fmt: skip
        parts += [head, writer.vector(POINTS, values, scalars, is_complex)]
    others = [lambda: writer.table("OQG1", [writer.heading(2, 3, 1, 1, 1.0, 0.0, 1, 8), writer.vector(POINTS, np.ones((3, 6)))]),
              lambda: writer.table("GEOM1", [writer.words(4501, 45, 1, 3)]), writer.matrix]  # fmt: skip
    has_masses = not is_complex and rng.random() < 0.6
    if has_masses:
        rows = b"".join(
            writer.words(
                k + 1, k + 1, float((2 * np.pi * f) ** 2), float(2 * np.pi * f), float(f), float(masses[k]), 1.0
            )
            for k, f in enumerate(frequency)
        )
        heading = writer.heading(2, 6, rng.choice((0, 1)), 0, 0, 0, 0, 7)
        others.append(lambda: writer.table("LAMA", [heading, rows], rng.choice((1, 2))))
    rng.shuffle(others)
    for write in others[:-1]:
        write()
    writer.table(name, parts, rng.choice((1, 1, 3)))
    others[-1]()
    return writer.end(), name, frequency, ratio, shapes, masses if has_masses else None


@pytest.mark.parametrize("seed", range(60))
def test_modes_of_binary_files_are_those_written(tmp_path, seed):
    content, name, frequency, ratio, shapes, masses = case(seed)
    path = tmp_path / "a.op2"
    path.write_bytes(content)
    units = {"length_unit": "mm", "force_unit": "N"} if masses is not None else {"length_unit": "mm"}
    modes = read_modes(path, ModeFileOptions(**units))
    assert modes.frequency == pytest.approx(frequency, rel=1e-6)
    assert modes.damping_ratio == pytest.approx(ratio, rel=1e-4, nan_ok=True)
    assert ("taken as global" in modes.source) == (name != "BOUGV1")
    rows = [3 * 2 * POINTS.index(dof.node) + dof.axis for dof in modes.channels]
    true = (shapes * np.array([1e-3] * 3 + [1.0] * 3)).reshape(len(frequency), -1)[:, rows]
    for k, found in enumerate(modes.mode_shapes.T):
        if masses is None:
            largest = true[k][np.argmax(np.abs(true[k]))]
            assert found == pytest.approx(true[k] / largest, abs=3e-6)
        else:
            assert found == pytest.approx(true[k].real / np.sqrt(masses[k] * 1e-3), rel=1e-5, abs=1e-6)


def real_file(parts=None, **changes):
    writer = Writer()
    values = {"approach": 2, "kind": 7, "subcase": 1, "mode": 1, "first": 100.0, "second": 0.0, "form": 1, "width": 8}
    head = writer.heading(**values | changes)
    writer.table(
        changes.pop("name", "OUGV1"), parts(writer, head) if parts else [head, writer.vector(POINTS, np.ones((3, 6)))]
    )
    return writer.end()


@pytest.mark.parametrize(
    "content, words",
    [
        (real_file(approach=8), "holds no eigenvectors of vibration"),
        (real_file(approach=1), "holds no eigenvectors of vibration"),
        (real_file(kind=2007), "sorted by points"),
        (real_file(first=-5e4), "negative eigenvalue"),
        (real_file(width=9), "has lines of 9 words"),
        (real_file(lambda w, h: [h, w.vector(POINTS, np.full((3, 6), np.nan))]), "holds NaN or infinite values"),
        (real_file(lambda w, h: [h, w.vector(POINTS, np.ones((3, 6)))] * 2), "has the vector of mode 1 .* twice"),
        (real_file()[:-300], "cut short"),
        (real_file()[:-13], "cut short"),
        (b"CDF\x01" + bytes(40), "does not begin as"),
        (real_file().replace(b"OUGV1   ", b"OUGV1PAT"), ""),
    ],
)  # fmt: skip
def test_binary_files_that_hold_something_else_are_refused(tmp_path, content, words):
    path = tmp_path / "a.op2"
    path.write_bytes(content)
    if not words:
        assert read_modes(path).frequency == pytest.approx([10 / (2 * np.pi)])
        (tmp_path / "a.bdf").write_text("BEGIN BULK\nGRID,1\nGRID,7\nGRID,99999999\nENDDATA\n")
        with pytest.raises(FileError, match="OUGV1PAT alone"):
            read_modes(path, ModeFileOptions(deck=tmp_path / "a.bdf"))
        return
    with pytest.raises(FileError, match=words):
        read_modes(path)


def test_vectors_in_basic_axes_are_taken_before_those_in_axes_of_their_own(tmp_path):
    writer = Writer()
    head = writer.heading(2, 7, 1, 1, 100.0, 0.0, 1, 8)
    writer.table("OUGV1", [head, writer.vector(POINTS, np.ones((3, 6)))])
    writer.table("BOUGV1", [head, writer.vector(POINTS, np.arange(1.0, 19.0).reshape(3, 6))])
    (tmp_path / "a.op2").write_bytes(writer.end())
    modes = read_modes(tmp_path / "a.op2")
    assert modes.mode_shapes[0, 0] == pytest.approx(1 / 15)
    assert "taken as global" not in modes.source


def test_binary_modes_in_the_loop_of_a_solver_have_unit_mass_and_are_turned_by_the_deck(tmp_path):
    """Point 7 moves along a system whose x is the basic y and whose y is the basic -x, unless the table is in the basic one."""
    grids = "".join(f"GRID,{point},,{k}.,0.,0.,{5 if point == 7 else ''}\n" for k, point in enumerate(POINTS))
    (tmp_path / "a.bdf").write_text(f"BEGIN BULK\nCORD2R,5,0,0.,0.,0.,0.,0.,1.\n,0.,1.,0.\n{grids}ENDDATA\n")
    out, met = ModesOut("a.op2", RunDeck("a.bdf", {})), set()
    for content, name, frequency, _, shapes, masses in (case(seed) for seed in range(60)):
        if masses is None:
            continue
        (tmp_path / "a.op2").write_bytes(content)
        run = out.read(tmp_path)
        true = shapes.real / np.sqrt(masses)[:, None, None]
        if name != "BOUGV1":
            x, y = true[:, 1, 0::3].copy(), true[:, 1, 1::3].copy()
            true[:, 1, 0::3], true[:, 1, 1::3] = -y, x
        assert run.has_mass
        assert run.frequency == pytest.approx(frequency, rel=1e-6)
        assert run.values == pytest.approx(true.reshape(len(frequency), -1).T, rel=1e-5, abs=1e-6)
        assert bool(run.notes) == (name != "BOUGV1")
        met.add(name == "BOUGV1")
    assert met == {True, False}
