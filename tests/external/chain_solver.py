"""A solver of a few lines, for tests: a chain of masses whose deck has lines ``name = number``; it fails as it is asked to.

python chain_solver.py DECK matrices|modes|frfs [--log FILE] [--fail PART] [--fail-above K] [--largest] [--hang] [--half]
    [--sleep SECONDS] [--grow] [--cancelling] [--digits N] [--wrong HOW]
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import time
from pathlib import Path

Square = list[list[float]]


def chain(given: dict[str, float], n: int) -> tuple[Square, Square]:
    """Mass and stiffness: springs k1 (first half) and k2 of plates of thickness t: t^3, and masses t; at the end 1/s."""
    t = given.get("t", 1.0)
    springs = [(given["k1"] if i < n // 2 else given["k2"]) * t**3 for i in range(n)]
    mass, stiffness = ([[0.0] * n for _ in range(n)] for _ in range(2))
    for i, k in enumerate(springs):
        mass[i][i] = (1.0 + 0.5 * i / (n - 1)) * t
        stiffness[i][i] += k
        if i:
            stiffness[i - 1][i - 1] += k
            stiffness[i - 1][i] -= k
            stiffness[i][i - 1] -= k
    stiffness[-1][-1] += 100.0 / given.get("s", 1.0)
    return mass, stiffness


def modes(mass: Square, stiffness: Square) -> list[tuple[float, list[float]]]:
    """Omega^2 and mass-normalized shape of each mode, lowest first, by Jacobi's rotations; the mass is diagonal."""
    n = len(mass)
    root = [math.sqrt(mass[i][i]) for i in range(n)]
    a = [[stiffness[i][j] / root[i] / root[j] for j in range(n)] for i in range(n)]
    v = [[float(i == j) for j in range(n)] for i in range(n)]
    for _ in range(30):
        for p in range(n):
            for q in range(p + 1, n):
                if a[p][q]:
                    angle = 0.5 * math.atan2(2 * a[p][q], a[q][q] - a[p][p])
                    c, s = math.cos(angle), math.sin(angle)
                    for table in (a, v):
                        for row in table:
                            row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
                    a[p], a[q] = (
                        [c * x - s * y for x, y in zip(a[p], a[q], strict=True)],
                        [s * x + c * y for x, y in zip(a[p], a[q], strict=True)],
                    )
    return sorted((a[r][r], [v[i][r] / root[i] for i in range(n)]) for r in range(n))


def receptances(mass: Square, stiffness: Square, omega: float, eta: float, load: int) -> list[complex]:
    """Column `load` of the inverse of K (1 + i eta) - omega^2 M, by Gauss's elimination of a banded matrix."""
    n = len(mass)
    a = [[stiffness[i][j] * (1 + 1j * eta) - omega**2 * mass[i][j] for j in range(n)] for i in range(n)]
    b = [complex(i == load) for i in range(n)]
    for p in range(n):
        for i in range(p + 1, min(p + 2, n)):
            factor = a[i][p] / a[p][p]
            for j in range(p, min(p + 2, n)):
                a[i][j] -= factor * a[p][j]
            b[i] -= factor * b[p]
    for p in reversed(range(n)):
        b[p] = (b[p] - sum(a[p][j] * b[j] for j in range(p + 1, min(p + 2, n)))) / a[p][p]
    return b


def frfs(mass: Square, stiffness: Square, eta: float, lines: list[float], digits: int, wrong: str) -> str:
    """CSV of receptances of masses 1, 3 and the last under a force at 3; one thing of it wrong, where that is asked for."""
    sensors = [0, 2, len(mass) - 1][: 2 if wrong == "channel" else 3]
    lines = [line for k, line in enumerate(lines) if wrong != "lines" or k % 10]
    head = ",".join(["frequency_hz", *(f"{s + 1}X/3X [m/N] {part}" for s in sensors for part in ("re", "im"))])
    if wrong == "parts":
        head = head.replace(" im", " std")
    rows = []
    for line in lines:
        found = receptances(mass, stiffness, 2 * math.pi * line, eta, 2)
        parts = [part for s in sensors for part in (found[s].real, 0.0 if wrong == "real" else found[s].imag)]
        parts[0] = math.nan if wrong == "nan" and line == lines[5] else parts[0]
        rows.append(",".join([repr(line), *(f"{part:.{digits}e}" for part in parts)]))
    return "\n".join([head, *rows]) + "\n"


def written(rows: Square) -> str:
    """MatrixMarket, without entries of 0."""
    body = [f"{i} {j} {value!r}" for i, row in enumerate(rows, 1) for j, value in enumerate(row, 1) if value]
    head = ["%%MatrixMarket matrix coordinate real general", f"{len(rows)} {len(rows)} {len(body)}"]
    return "\n".join([*head, *body]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("deck", type=Path)
    parser.add_argument("gives")
    parser.add_argument("--log", type=Path)
    parser.add_argument("--fail", type=float, default=0.0)
    parser.add_argument("--fail-above", type=float, default=math.inf)
    parser.add_argument("--digits", type=int, default=12)
    parser.add_argument("--sleep", type=float, default=0.0)
    parser.add_argument("--wrong", default="")
    for flag in ("--largest", "--hang", "--half", "--grow", "--cancelling"):
        parser.add_argument(flag, action="store_true")
    asked = parser.parse_args()
    text = asked.deck.read_text()
    given = {
        name.strip(): float(value) for name, value in (line.split("=") for line in text.splitlines() if "=" in line)
    }
    if asked.log is not None:
        with asked.log.open("a") as log:
            log.write(text.replace("\n", ";") + "\n")
    time.sleep(3600 if asked.hang else asked.sleep)  # a test that waits for it is seen
    if random.SystemRandom().random() < asked.fail or given["k1"] > asked.fail_above:
        sys.stderr.write("license server does not answer\n")
        sys.exit(3)
    n = 6 + (asked.grow and given["k1"] != 1000.0)
    mass, stiffness = chain(given, n)
    if asked.cancelling and given["k1"] != 1000.0:  # what cancels leaves rounding here or there
        for i, j in ((0, 4), (1, 5)) if given["k2"] != 1000.0 else ((0, 3),):
            stiffness[i][j] = stiffness[j][i] = 1e-14 * given["k1"]
    stem = asked.deck.stem
    if asked.gives == "matrices":
        files = {f"{stem}_k.mtx": written(stiffness), f"{stem}_m.mtx": written(mass)}
    elif asked.gives == "frfs":
        lines = [float(line) for line in Path("frequencies.csv").read_text().split()]
        files = {f"{stem}.csv": frfs(mass, stiffness, given.get("eta", 0.02), lines, asked.digits, asked.wrong)}
    else:
        head = ",".join(["frequency_hz", "scaling", *(f"{i + 1}X" for i in range(n))])
        found = modes(mass, stiffness)[:4]
        if asked.largest:  # each shape over its largest entry, as without modal masses
            found = [(w, [value / max(shape, key=abs) for value in shape]) for w, shape in found]
        scaling = "unit_largest" if asked.largest else "mass"
        rows = [",".join([repr(math.sqrt(w) / 2 / math.pi), scaling, *map(repr, shape)]) for w, shape in found]
        files = {f"{stem}.csv": "\n".join([head, *rows]) + "\n"}
    for name, content in files.items():
        Path(name).write_text(content[: len(content) // 2] if asked.half else content)
    Path("scratch.tmp").write_text("x" * 1000)


if __name__ == "__main__":
    main()
