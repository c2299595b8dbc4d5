"""A process that reads one damaged file after another and says what came of each: a line in, a line out."""

from __future__ import annotations

import json
import os
import resource
import sys
import traceback
import warnings
from pathlib import Path

from structid.core.errors import StructidError

BYTES = 4 * 2**30


def main() -> None:
    """Serve until there is nothing more to read."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")  # numbers at their extremes overflow, and are then refused or not
    from fuzz.targets import TARGETS

    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers.write("ready\n")
    answers.flush()
    for line in sys.stdin:
        case = json.loads(line)
        path = Path(case["path"])
        outcome, words = "read", ""
        try:
            TARGETS[case["target"]](path)
        except StructidError as error:
            outcome, words = "refused", str(error)
        except BaseException as error:
            outcome, words = "other", "".join(traceback.format_exception(error))[-1500:]
        answers.write(json.dumps([outcome, words]) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
