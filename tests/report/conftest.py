"""Reports written once, with their PNG files, for all tests of this folder."""

from __future__ import annotations

import pytest
import report_cases
from written_reports import Report, written

from structid.identification.identified import Identification


@pytest.fixture(scope="session")
def cantilever(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return written(report_cases.cantilever(120), tmp_path_factory.mktemp("cantilever"))


@pytest.fixture(scope="session")
def series(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return written(report_cases.springs_in_series(), tmp_path_factory.mktemp("series"))


@pytest.fixture(scope="session")
def many() -> Identification:
    return report_cases.many(n_lines=40, iterations=2)
