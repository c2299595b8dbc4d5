"""Modes above half the sampling rate, which forces straight between samples excite: they are told of."""

import numpy as np
import pytest

from short_record_cases import SENSORS
from structid import (
    Base,
    IdentifyOptions,
    PointMass,
    Spring,
    Structure,
    TimeFit,
    TimeRecord,
    TimeSetup,
    Unknown,
    parameters,
)
from structid.identification.setups.setup import prepared_warnings

#: Hz, of four equal masses of 2 kg on springs of 1000 N/m, held at one end: in closed form.
NATURAL = np.sqrt(1000.0 / 2.0) * 2 * np.sin(np.pi * (2 * np.arange(1, 5) - 1) / 18) / (2 * np.pi)


def chain_of(stiffness, mass=2.0, **supports):
    """Equal masses in a row on springs, the first of which is held."""
    n = len(stiffness)
    springs = Spring("k", [f"{i + 1}X" for i in range(n)], [f"{i}X" for i in range(n)], stiffness=stiffness)
    masses = PointMass("m", list(range(1, n + 1)), mass)
    return Structure({i: float(i) for i in range(n + 1)}, [masses, springs], fixed=["0X"], active=["X"], **supports)


def warnings_at(rate, hold, structure=None, load=("4X", "force")):
    values = np.random.default_rng(0).standard_normal((200, 3))
    record = TimeRecord(
        rate, values, (load[0], *SENSORS), (load[1], "acceleration", "acceleration"), variance=np.ones(3)
    )
    structure = chain_of(np.full(4, 1000.0)) if structure is None else structure
    unknown = parameters(structure, [Unknown("stiffness", "k")])
    setup = TimeSetup(structure, unknown, record, TimeFit(hold=hold))
    warnings = prepared_warnings([setup], [setup.prepared(IdentifyOptions())])
    return [words for words in warnings if "half the sampling rate" in words]


@pytest.mark.parametrize("count", [1, 3])
def test_modes_above_half_the_rate_are_counted(count):
    lowest = NATURAL[-count]
    [words] = warnings_at(2 * 0.95 * lowest, "first")
    assert f"the model has {count} such mode" in words
    assert f"the lowest at {lowest:.4g} Hz" in words
    assert words.startswith("forces that run straight")


def test_nothing_is_said_of_filtered_forces_or_of_modes_below():
    assert warnings_at(2 * 0.95 * NATURAL[-3], "band_limited") == []
    assert warnings_at(2 * 1.05 * NATURAL[-1], "first") == []


def test_a_stiff_local_mode_far_above_half_the_rate_is_not_told_of():
    """Its response is that of a spring or a mass, which the model has."""
    local = chain_of([1000.0, 1000.0, 1000.0, 1e8])
    assert warnings_at(2 * 8.0, "first", local) == []


@pytest.mark.parametrize(
    ("half_rate", "count"),
    [(20.0, "has at least 1 such mode"), (8.0, "has at least 5 such modes"), (3.0, "has 5 such modes")],
)
def test_of_a_large_chain_the_first_modes_behind_the_samples_are_found(half_rate, count):
    """650 masses of 1 kg on springs of 5e5 N/m, held at one end: modes in closed form, of which 20 are searched as usual."""
    natural = np.sqrt(5e5) / np.pi * np.sin(np.pi * (2 * np.arange(1, 651) - 1) / (4 * 650 + 2))
    [words] = warnings_at(2 * half_rate, "first", chain_of(np.full(650, 5e5), mass=1.0))
    assert count in words
    assert f"the lowest at {natural[natural > half_rate].min():.4g} Hz" in words


def test_supports_that_move_are_called_so():
    shaken = chain_of(np.full(4, 1000.0), bases=[Base("ground", "0X")])
    [words] = warnings_at(2 * 0.95 * NATURAL[-1], "first", shaken, ("0X", "support_acceleration"))
    assert words.startswith("motions of supports that run straight")
