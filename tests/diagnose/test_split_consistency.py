"""Parts of the data whose fits disagree: which parameter is named."""

import numpy as np
import pytest

from structid.diagnose.split_consistency import disagreements
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study
from study_cases import write_chain


class Fits:
    """Work whose fits of the two halves of the band are given: all values alike but for some, by factors."""

    def __init__(self, std, **factors):
        self.std, self.factors = std, factors

    def map(self, name, task, shared, items):
        found = []
        for (number, _), problem in zip(items, shared.problems, strict=True):
            values = np.ones(len(problem.names))
            for word, factor in self.factors.items() if number else ():
                values[[name.startswith(word) for name in problem.names]] = factor
            std = np.array([self.std[name.partition("[")[0]] for name in problem.names])
            found.append({"values": values, "std": std, "changes": np.zeros((len(std), 1)), "errors": np.zeros(1)})
        return found


STD = {"mass": 1e-3, "stiffness": 1e-3, "loss_factor": 1e-2, "viscous_damping": 1e-2}


@pytest.mark.parametrize(
    ("factors", "name"),
    [
        ({"stiffness": 1.02, "loss_factor": 1.1}, "loss_factor[springs]"),  # 14 deviations, but 2 %, and 7
        ({"stiffness": 1.02, "mass": 1.04, "loss_factor": 1.9}, "mass[mass 1]"),  # no damping where another differs
        ({"mass": 1.02}, None),
    ],
)
def test_the_value_that_is_named_is_itself_beyond_the_limits(tmp_path, factors, name):
    problems = prepare_study(load_study(write_chain(tmp_path))).problems
    theta = problems[0].theta_start
    assert [one.name for one in disagreements(problems, theta, Fits(STD, **factors))] == ([name] if name else [])
