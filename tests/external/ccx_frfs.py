"""FRFs out of CalculiX: one step of *STEADY STATE DYNAMICS for each line of frequencies.csv, as CSV.

python ccx_frfs.py DECK LOAD SENSOR ...

LOAD and SENSORs are such as 15Z. The deck ends with the step *FREQUENCY, STORAGE=YES; what stands behind its line
``** RESPONSE`` is written once a frequency, with *STEP and *END STEP around it and FREQUENCY in place of that word.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def displacements(frd: Path, nodes: set[int]) -> dict[tuple[str, str], dict[int, list[float]]]:
    """By frequency and part, DISP or DISPI: displacements of nodes."""
    found: dict[tuple[str, str], dict[int, list[float]]] = {}
    frequency, into = "", None
    for line in frd.read_text().splitlines():
        if line.startswith("  100C"):
            frequency = line[12:24].strip()
        elif line.startswith(" -4"):
            name = line.split()[1]
            into = found.setdefault((frequency, name), {}) if name in ("DISP", "DISPI") else None
        elif line.startswith(" -1") and into is not None and int(line[3:13]) in nodes:
            into[int(line[3:13])] = [float(line[13 + 12 * k : 25 + 12 * k]) for k in range(3)]
        elif line.startswith(" -3"):
            into = None
    return found


def main() -> None:
    deck, load, *sensors = sys.argv[1:]
    model, _, response = Path(deck).read_text().partition("** RESPONSE\n")
    lines = Path("frequencies.csv").read_text().split()
    steps = "".join(f"*STEP\n{response.replace('FREQUENCY', line)}*END STEP\n" for line in lines)
    Path("ssd.inp").write_text(model + steps)
    subprocess.run(["ccx", "ssd"], check=True)
    found = displacements(Path("ssd.frd"), {int(sensor[:-1]) for sensor in sensors})
    head = ",".join(["frequency_hz", *(f"{sensor}/{load} [m/N] {part}" for sensor in sensors for part in ("re", "im"))])
    rows = []
    known = {float(frequency): frequency for frequency, _ in found}
    for line in lines:
        own = known[min(known, key=lambda f: abs(f - float(line)))]
        parts = [
            found[own, part][int(sensor[:-1])]["XYZ".index(sensor[-1])]
            for sensor in sensors
            for part in ("DISP", "DISPI")
        ]
        rows.append(",".join(map(repr, [float(own), *parts])))
    Path(f"{Path(deck).stem}.csv").write_text("\n".join([head, *rows]) + "\n")


if __name__ == "__main__":
    main()
