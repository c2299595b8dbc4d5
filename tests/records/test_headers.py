"""Every variation of a header is read as it says, or refused: files of a writer that shares nothing with structid."""

from collections import Counter

import pytest
from header_cases import judge
from laboratory_cases import WRITERS

from structid.core.errors import InputError
from structid.records import ReadOptions, read_record
from structid.records.formats import CsvLayout


def read(path, options):
    layout = CsvLayout(**options["csv"]) if "csv" in options else None
    return read_record(path, ReadOptions(**(options | {"csv": layout})))


@pytest.mark.parametrize("kind", WRITERS)
def test_headers_are_read_right_or_refused(tmp_path, kind):
    outcomes = Counter()
    for seed in range(200):
        case = WRITERS[kind](f"fixed {seed}")
        outcome, words = judge(case, tmp_path / f"a{case.suffix}", read, InputError)
        outcomes[outcome] += 1
        assert outcome in ("read", "refused"), f"{kind} {seed} {outcome}: {words}\n" + "\n".join(map(str, case.notes))
    assert min(outcomes["read"], outcomes["refused"]) > 40
