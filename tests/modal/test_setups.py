"""Set-ups from their records: a mode that one lost is looked for again, and what no set-up measured stays unknown."""

from dataclasses import replace

import numpy as np
import pytest

from modes_cases import FREQUENCY, SHAPES, ambient
from structid.modal.merging import merged_setups
from structid.modal.survey import setups
from structid.modal.survey.setups import modes_of_setups, recovered_modes
from structid.modal.survey.survey import modes_of_file
from structid.records import write_record
from structid.report.modes import modes_page
from structid.similarity import mac
from structid.study.results.modes import write_modes_results


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Records of three set-ups, two with sensors 1 and 2, one with 1 and 3, each with its modes alone."""
    folder = tmp_path_factory.mktemp("three")
    for name, sensors, seed in (("a", [0, 1], 3), ("b", [0, 1], 4), ("c", [0, 2], 5)):
        whole = ambient(seed=seed)
        channels = tuple(whole.channels[i] for i in sensors)
        kinds = whole.quantities[:2]
        part = replace(whole, values=whole.values[:, sensors], channels=channels, quantities=kinds)
        write_record(folder / f"{name}.npz", part)
    paths = [folder / f"{name}.npz" for name in "abc"]
    return {path: modes_of_file(path) for path in paths}


def without(result, mode):
    """`result` as if it had lost one of its modes."""
    keep = np.arange(result.modes.n_modes) != mode
    return replace(result, identification=result.identification.kept(keep, "lost here"))


def test_a_lost_mode_is_found_again_in_its_record(three):
    each = list(three.values())
    places = [int(np.abs(result.modes.frequency - FREQUENCY[1]).argmin()) for result in each]
    lacking = [each[0], each[1], without(each[2], places[2])]
    merging = merged_setups([result.modes for result in lacking])
    again = recovered_modes(lacking[2], merging, 2)
    assert again is not None
    expected = each[2].modes.some_modes([places[2]])
    np.testing.assert_allclose(again.frequency, expected.frequency, rtol=2e-3)
    assert mac(again.mode_shapes, expected.mode_shapes).item() > 0.99
    assert recovered_modes(each[0], merging, 0) is None


def test_unmeasured_entries_stay_unknown_where_a_mode_is_not_found_again(three, monkeypatch, tmp_path):
    """The third set-up, alone with sensor 3, never shows mode 2: results and page say so."""
    paths, third = list(three), list(three.values())[2]
    lost = without(third, int(np.abs(third.modes.frequency - FREQUENCY[1]).argmin()))
    read = dict(zip(paths, [*list(three.values())[:2], lost], strict=True))
    monkeypatch.setattr(setups, "read_and_identify", lambda path, *_, **options: read[path])
    found_again = modes_of_setups(paths)
    assert any("found again" in step for step in found_again.steps)
    assert found_again.modes.known.all()
    assert (np.diag(mac(found_again.modes.mode_shapes, SHAPES)) > 0.98).all()
    monkeypatch.setattr(setups, "recovered_modes", lambda *_: None)
    result = modes_of_setups(paths)
    np.testing.assert_allclose(result.modes.frequency, FREQUENCY, rtol=0.01)
    assert (~result.modes.known).nonzero() == ([2], [1])
    write_modes_results(result, tmp_path)
    assert not (tmp_path / "modes.uff").exists()
    assert modes_page(result).text.count("nan") == modes_page(found_again).text.count("nan")
