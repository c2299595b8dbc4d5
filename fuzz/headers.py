"""`python -m fuzz.headers`: record files over the variations of their headers, each with known truth, and how they were read.

The semantic twin of `python -m fuzz`: a damaged file must be read or refused, and a whole one read as it says or refused. The
files are those of `header_cases.py` and `laboratory_cases.py` in `tests/records`, whose writers share nothing with structid.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from structid.core.errors import InputError
from structid.records import ReadOptions, Record, read_record
from structid.records.formats import CsvLayout

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "records"))
from header_cases import judge
from laboratory_cases import WRITERS

OUTCOMES = ("read", "refused", "wrong", "lost", "other")


def read_case(path: Path, options: dict[str, Any]) -> Record:
    """The record of a case of a writer, by its options."""
    layout = CsvLayout(**options["csv"]) if "csv" in options else None
    return read_record(path, ReadOptions(**(options | {"csv": layout})))


def main() -> int:
    """Run, print, and say by the exit code whether anything was read wrongly, or refused though it says all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="how many files [default: 2000]")
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers [default: 1]")
    given = parser.parse_args()
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in WRITERS}
    bad: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for index in range(given.count):
            kind = list(WRITERS)[index % len(WRITERS)]
            case = WRITERS[kind](f"{given.seed} {index}")
            try:
                outcome, words = judge(case, Path(folder) / f"a{case.suffix}", read_case, InputError)
            except Exception as error:  # whatever it is, it is no refusal
                outcome, words = "other", repr(error)
            counts[kind][outcome] += 1
            if outcome not in ("read", "refused"):
                bad.append(f"{outcome}: {kind} {given.seed} {index}: {words}\n  " + "\n  ".join(map(str, case.notes)))
    print(f"{'file':12s}{'files':>8s}" + "".join(f"{name:>9s}" for name in OUTCOMES))
    for kind, count in [*counts.items(), ("all", sum(counts.values(), Counter()))]:
        print(f"{kind:12s}{count.total():8d}" + "".join(f"{count[outcome]:9d}" for outcome in OUTCOMES))
    print("\n".join(bad[:40]))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
