"""Every method of modal identification finds the modes of a simulated record of the kind that it is meant for."""

import numpy as np
import pytest
from frf_cases import chain, frf
from modal_cases import ambient_chain, chain_modes, decay, nearest

from structid import identify_modes, mac
from structid.modal.identification import METHODS


def free_decay():
    omega, shapes = chain_modes()
    start = {"velocity": shapes[0], "damping_ratio": 0.01}
    return decay(omega, shapes, 60.0, 0.05, noise=0.01, **start), omega / (2 * np.pi), shapes


def ambient():
    omega, shapes = chain_modes()
    return ambient_chain(seed=3), omega / (2 * np.pi), shapes


def responses():
    frequency, shapes = chain()
    return frf(frequency, shapes, noise=0.01), frequency, shapes


#: A record with its frequencies and shapes, the error of a frequency and of 1 - MAC, for every method.
MEANT_FOR = {
    "pencil": (free_decay, 1e-3, 1e-3),
    "era": (free_decay, 1e-3, 1e-3),
    "era_dc": (free_decay, 1e-3, 1e-3),
    "itd": (free_decay, 1e-3, 1e-3),
    "ssi_cov": (ambient, 5e-3, 1e-2),
    "ssi_data": (ambient, 5e-3, 1e-2),
    "next_era": (ambient, 5e-3, 1e-2),
    "fdd": (ambient, 1.5e-2, 1e-2),  # half of a line, lines being 0.016 Hz apart
    "efdd": (ambient, 1e-2, 1e-2),
    "bayesian_fft": (ambient, 5e-3, 1e-2),
    "lscf": (responses, 1e-4, 1e-3),
}


@pytest.mark.parametrize("method", METHODS)
def test_a_method_finds_the_modes_of_a_record_it_is_meant_for(method):
    simulated, frequency_error, shape_error = MEANT_FOR[method]
    record, frequency, shapes = simulated()
    found = identify_modes(record, method)
    own = nearest(found.frequency, frequency)
    assert len(set(own)) == len(frequency)
    assert found.frequency[own] == pytest.approx(frequency, rel=frequency_error)
    assert np.diag(mac(found.mode_shapes[:, own], shapes)) == pytest.approx(1.0, abs=shape_error)
