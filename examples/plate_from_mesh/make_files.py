"""The mesh of a plate with a thicker strip, as Gmsh writes it, and simulated FRFs with 1 % noise."""

from pathlib import Path

import numpy as np

import structid as sid

HERE = Path(__file__).parent
#: Size in mm, cells along each side, and the columns of cells that are thicker.
LENGTH, WIDTH, COLUMNS, ROWS, STRIP = 400.0, 300.0, 8, 6, (4, 5)
#: What the study does not know.
YOUNG, STRIP_THICKNESS, LOSS_FACTOR = 68e9, 4.2e-3, 0.03
SENSORS = {9001: (0.30, 0.05), 9002: (0.40, 0.25), 9003: (0.15, 0.20), 9004: (0.25, 0.15)}


def mesh_text():
    """Quadrilaterals, those of the last column split into triangles, and the rim at x = 0 as lines."""
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.linspace(0, LENGTH, COLUMNS + 1), np.linspace(0, WIDTH, ROWS + 1), indexing="ij")
    inner = (x > 0) & (x < LENGTH) & (y > 0) & (y < WIDTH)
    x, y = (axis + 6.0 * inner * rng.uniform(-1, 1, axis.shape) for axis in (x, y))
    number = np.arange(1, x.size + 1).reshape(x.shape)
    nodes = [f"{n} {a:.4f} {b:.4f} 0" for n, a, b in zip(number.flat, x.flat, y.flat, strict=True)]
    cells = [f"1 2 3 1 {a} {b}" for a, b in zip(number[0, :-1], number[0, 1:], strict=True)]
    for i in range(COLUMNS):
        for j in range(ROWS):
            a, b, c, d = number[i, j], number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]
            tag = f"2 {2 if i in STRIP else 1} 1"
            cells += (
                [f"2 {tag} {a} {b} {c}", f"2 {tag} {a} {c} {d}"] if i == COLUMNS - 1 else [f"3 {tag} {a} {b} {c} {d}"]
            )
    numbered = [f"{k} {cell}" for k, cell in enumerate(cells, 1)]
    names = ['2 1 "skin"', '2 2 "strip"', '1 3 "clamp"']
    parts = {"MeshFormat": ["2.2 0 8"], "PhysicalNames": ["3", *names]}
    parts |= {"Nodes": [str(len(nodes)), *nodes], "Elements": [str(len(numbered)), *numbered]}
    return "".join(f"${name}\n{chr(10).join(lines)}\n$End{name}\n" for name, lines in parts.items())


def true_structure():
    """The plate as it is."""
    mesh = sid.read_mesh(HERE / "plate.msh", "mm")
    common = {"youngs_modulus": YOUNG, "density": 2700.0, "poisson": 0.33, "loss_factor": LOSS_FACTOR}
    skin = sid.Plate("skin", mesh.cells("skin"), thickness=3e-3, **common)
    strip = sid.Plate("strip", mesh.cells("strip"), thickness=STRIP_THICKNESS, **common)
    points = sid.mesh_points(mesh, [skin, strip], {label: (x, y, 0.0) for label, (x, y) in SENSORS.items()})
    nodes = mesh.nodes | {point.label: mesh.nodes[point.node] for point in points}
    held = [f"{node}{d}" for node in mesh.group_nodes("clamp") for d in ("Z", "RX", "RY")]
    return sid.Structure(nodes, [skin, strip], held, points)


def main():
    """Writes both files."""
    (HERE / "plate.msh").write_text(mesh_text(), encoding="utf-8")
    structure = true_structure()
    frequency = np.linspace(5.0, 160.0, 156)
    outputs, inputs = [f"{label}Z" for label in SENSORS], ["9001Z"]
    empty = sid.FrfRecord(frequency, np.ones((len(frequency), 4, 1)), outputs, inputs, "accelerance")
    known = sid.parameters(structure, [])
    record = sid.simulated_record(structure, known, empty, relative_noise=0.01, rng=np.random.default_rng(11))
    sid.write_record(HERE / "frf.npz", record)


if __name__ == "__main__":
    main()
