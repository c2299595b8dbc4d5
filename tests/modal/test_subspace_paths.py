"""Fast paths of the subspace kernel give the poles of the plain ones."""

import numpy as np
import pytest
from modal_cases import ambient_chain

from structid.modal import ModalOptions, modal_identification
from structid.modal.subspace import kernel as subspace
from structid.modal.subspace import methods

RECORD = ambient_chain(3)
OPTIONS = ModalOptions(orders=[8, 12], block_rows=20, n_pieces=0)


def poles(method, options=OPTIONS):
    return [p.poles for p in modal_identification(RECORD, method, options).sweep]


def test_data_driven_projection_by_cholesky_is_that_by_qr(monkeypatch):
    fast = poles("ssi_data")
    monkeypatch.setattr(methods, "_REGULAR", 1.0)
    calls = []
    plain = methods.delayed_triangle
    monkeypatch.setattr(methods, "delayed_triangle", lambda *given: calls.append(1) or plain(*given))
    slow = poles("ssi_data")
    assert calls == [1]
    for a, b in zip(fast, slow, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)


@pytest.mark.parametrize("method", ["pencil", "ssi_cov", "ssi_data"])
def test_leading_singular_vectors_are_those_of_the_complete_decomposition(method, monkeypatch):
    complete = poles(method)
    monkeypatch.setattr(subspace, "_LARGE", 10)
    found = subspace._singular_vectors(np.diag(np.arange(80.0)), 5, complete=False)
    assert len(found[1]) == 5
    np.testing.assert_allclose(found[1], [79.0, 78.0, 77.0, 76.0, 75.0], rtol=1e-12)
    for a, b in zip(poles(method), complete, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
