"""Options of modal identification: arrays wherever a sequence goes, and no list without a number."""

from dataclasses import fields

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.modal import HardCriteria, ModalOptions
from structid.modal.survey.options import ModesOptions

#: A sequence for each field of every class of options that takes one.
SEQUENCES = {
    ModalOptions: {"orders": (4, 6), "frequencies": (1.9, 2.4), "bands": ((0.5, 1.0), (1.5, 3.0))},
    HardCriteria: {"frequency": (0.5, 3.0), "damping_ratio": (0.0, 0.1)},
    ModesOptions: {
        "band": (0.5, 3.0),
        "frequencies": (1.9, 2.4),
        "orders": (4, 6),
        "remove_tones": (25.0, 50.0),
        "damping": (0.0, 0.1),
    },
}


@pytest.mark.parametrize("options", SEQUENCES)
def test_every_sequence_may_be_an_array(options):
    takes = [field.name for field in fields(options) if "Sequence[" in field.type or "tuple[" in field.type]
    assert sorted(takes) == sorted(SEQUENCES[options])
    for name, sequence in SEQUENCES[options].items():
        made = options(**{name: np.array(sequence)})
        assert np.array_equal(getattr(made, name), sequence)
        assert made == options(**{name: type(sequence)(map(list, sequence)) if name == "bands" else sequence})


@pytest.mark.parametrize(
    "name, number", [("orders", 20), ("orders", np.int64(20)), ("frequencies", 2.5), ("remove_tones", np.float64(50.0))]
)
def test_one_number_is_a_list_of_one(name, number):
    found = getattr(ModesOptions(**{name: number}), name)
    assert found == (number,)
    assert type(found[0]) in (int, float)


@pytest.mark.parametrize("name", ["orders", "frequencies", "remove_tones"])
@pytest.mark.parametrize("empty", ["", " , ", (), [], np.array([])])
def test_a_list_without_a_number_is_refused(name, empty):
    with pytest.raises(InputError, match=f"`{name}` must hold at least one number, as in .*; or leave it out"):
        ModesOptions(**{name: empty})
