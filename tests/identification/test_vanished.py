"""A stiffness that is gone: known well about 0 where it may be negative."""

import numpy as np
import pytest
from chain_cases import STIFFNESS, chain, record

from structid import Spring, Status, Structure, Unknown, identify, parameters


@pytest.mark.parametrize("seed", range(4))
def test_a_brace_that_is_gone_is_determined(seed):
    own = chain()
    brace = Spring("brace", "2X", "4X", stiffness=300.0)
    braced = Structure(own.nodes, [*own.elements, brace], own.fixed, active=["X"])
    unknown = [Unknown("stiffness", "k", each=True), Unknown("stiffness", "brace", positive=False)]
    answer = identify(braced, parameters(braced, unknown), record(own, seed=seed)).estimate
    assert answer.status is Status.CONVERGED
    assert answer.identified.all()
    assert abs(answer.values[4]) < 4 * answer.std[4] < 30.0
    np.testing.assert_allclose(answer.values[:4], STIFFNESS, rtol=0.05)
