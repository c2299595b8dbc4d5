"""Norris (1986), chapter 5: Tables 5.1 and 5.2 against their printed digits, and what explains them."""

import numpy as np
import pytest

from structid.modal.rayleigh import pseudo_rayleigh
from structid.reproduce.chapter_5 import beam_record, folded_omega, items, membrane_eigenvalues, membrane_record
from structid.reproduce.reproduction import ReproducedItem, Verdict
from structid.similarity import mac

BEAM = [0.09834, 0.39433, 0.88821, 1.57910, 2.46734, 3.55311, 6.68212, 8.49410, 10.19992, 11.46529]
BEAM_ACTUAL = [0.09870, 0.39478, 0.88826, 1.57914, 2.46740, 3.55306, 4.83611, 6.31655, 7.99438, 9.86960]
MEMBRANE = [0.0, 1.1912, 1.1915, 2.7641, 5.8445, 5.8544, 7.8315, 9.4418, 12.0, 12.0, 15.3027, 16.0685, 17.8975]
MEMBRANE += [25.1564, 25.6702, 29.5497]
MEMBRANE_IDENTIFIED = [0.0, 1.1835, 1.1948, 2.7669, 5.8482]


@pytest.fixture(scope="module")
def made() -> dict[str, ReproducedItem]:
    seen = []
    found = items(lambda name, part: seen.append(part))
    assert seen == sorted(seen)
    assert (seen[0], seen[-1]) == (0.0, 1.0)
    return {item.name: item for item in found}


def test_every_table_and_figure_is_there_with_its_verdict(made):
    verdicts = {name: item.verdict for name, item in made.items()}
    assert verdicts == {
        "Table 5.1": Verdict.READING,
        "Table 5.2": Verdict.READING,
        "Figure 5.1": Verdict.READING,
        "Figure 5.2": Verdict.READING,
        "Figure 5.3": Verdict.READING,
        "Figure 5.4": Verdict.REFUTED,
        "Claim: ten modes": Verdict.REFUTED,
        "Claim: close frequencies": Verdict.REFUTED,
    }
    assert all(item.note for item in made.values())


def test_table_5_1(made):
    table = made["Table 5.1"].tables[0]
    assert table.printed == pytest.approx(np.array([BEAM_ACTUAL, BEAM]).T)
    actual, identified = table.difference.T
    assert np.abs(actual).max() <= 0.5e-5
    assert np.abs(identified[:6]).max() <= 1e-5
    assert np.abs(identified[6:]).max() <= 2e-4
    assert made["Table 5.1"].max_abs_difference == pytest.approx(1.47e-4, abs=1e-6)
    assert np.abs(made["Table 5.1"].tables[1].difference).max() <= 0.051  # per cent, printed to 0.1


def test_table_5_1_fits_no_other_form(made):
    chosen, trapezoid, velocities, one_sided = np.abs(made["Table 5.1"].tables[2].difference).max(axis=0)
    assert chosen < 2e-4 < min(trapezoid, one_sided)
    assert velocities > 5e-3
    assert trapezoid > 4e-4


def test_folded_modes_explain_modes_7_to_10():
    assert folded_omega() == pytest.approx(BEAM[6:], rel=6e-4)
    assert folded_omega() == pytest.approx([6.68265, 8.49171, 10.19523, 11.46446], abs=0.6e-5)
    found = pseudo_rayleigh(beam_record(duration=3000.0), form="as_printed").omega[6:]
    assert found == pytest.approx(folded_omega(), rel=1e-4)  # the limit of long records


def test_beam_of_ten_modes_is_found_and_of_fifteen_is_warned_of():
    found = pseudo_rayleigh(beam_record(), "displacement-acceleration", "symmetric_acceleration", "interior")
    assert any("more modes than sensors" in note for note in found.warnings)
    ten = pseudo_rayleigh(beam_record(n_modes=10), "displacement-acceleration", "exact")
    assert ten.omega == pytest.approx(BEAM_ACTUAL, abs=0.5e-5)
    assert ten.warnings == ()


def test_table_5_2(made):
    table = made["Table 5.2"].tables[0]
    assert table.printed[:, 0] == pytest.approx(MEMBRANE)
    assert np.abs(table.difference[:, 0]).max() <= 5e-5
    assert table.printed[:5, 1] == pytest.approx(MEMBRANE_IDENTIFIED)
    assert np.abs(table.difference[:5, 1]).max() <= 5e-4
    assert np.isnan(table.printed[5:, 1]).all()
    assert np.abs(made["Table 5.2"].tables[1].difference).max() <= 0.09
    readings = np.abs(made["Table 5.2"].tables[2].difference).max(axis=0)
    assert readings[0] <= 5e-4
    assert (readings[1:] >= 7e-3).all()


def test_exact_forms_find_the_membrane(made):
    computed = made["Table 5.2"].tables[2].computed
    expected = membrane_eigenvalues()[:5]
    assert computed[:, 2] == pytest.approx(expected, abs=1e-7)
    assert computed[:, 3] == pytest.approx(expected, abs=1e-9)


def test_shapes_of_the_beam_agree(made):
    for name, least in (("Figure 5.1", 0.997), ("Figure 5.2", 0.996)):
        item = made[name]
        assert item.tables[0].computed.min() >= least
        assert len(item.panels) == 5
        for panel in item.panels:
            fine, sensors = panel.curves
            at_sensors = np.interp(sensors.x, fine.x, fine.y)
            assert mac(at_sensors, sensors.y).item() >= least
            assert np.abs(at_sensors - sensors.y).max() <= 0.07 * np.abs(fine.y).max()


def test_only_parallel_diagonals_have_the_printed_eigenvalues(made):
    best, second, third = made["Figure 5.3"].tables[0].computed[:, 0]
    assert max(best, second) <= 5e-5
    assert third >= 0.4
    mesh = made["Figure 5.3"].panels[0].curves[0]
    steps = np.abs(np.diff([mesh.x, mesh.y], axis=1))
    along = (steps[0] == 0) | (steps[1] == 0) | (steps[0] == steps[1])
    assert along.all()


def test_close_pair_of_the_membrane_is_mixed_from_every_start(made):
    likeness = made["Figure 5.4"].tables[0].computed
    assert likeness.shape == (8, 6)
    assert likeness[:, [0, 3, 4]].min() >= 0.999
    assert likeness[:, 1:3].min(axis=1).max() <= 0.25
    pair, repeated = made["Claim: close frequencies"].tables
    assert pair.computed[0, 2] > 30
    assert pair.computed[-1, 2] < 5
    assert pair.computed[:, 3:] == pytest.approx(np.tile(membrane_eigenvalues()[1:3], (3, 1)), abs=1e-7)
    assert repeated.computed[:, 0].tolist() == [15.0, 16.0]


def test_warnings_name_the_pair():
    record = membrane_record(np.sqrt(membrane_eigenvalues()))
    notes = pseudo_rayleigh(record, "velocity-acceleration", "as_printed").warnings
    assert any("16 channels reduced to 5" in note for note in notes)
    assert any("modes 2 and 3 (near 1.0914 and 1.0915 rad/s)" in note for note in notes)
