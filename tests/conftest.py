"""Nothing here depends on how fast the machine is: Hypothesis has no deadline, and commands print no progress once a minute."""

import math

import pytest
from hypothesis import HealthCheck, settings

from structid.cli import console

settings.register_profile("structid", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("structid")


@pytest.fixture(scope="session", autouse=True)
def _no_progress_lines():
    """No command that is called in this process adds a line of progress to its errors, however long it takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(console, "_LINE_SECONDS", math.inf)
        yield
