"""The GARTEUR aeroplane from its published geometry: close to the published frequencies before updating, at them after."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import structid as sid
from structid.cli.app import app
from structid.compare.correlation import correlate

STUDY = Path(__file__).parents[2] / "examples" / "garteur_aeroplane" / "study.toml"
SIGNS = {33.12: -1.0, 33.53: 1.0}  # of the right tip's pitch against the left one's


def test_stiffnesses_and_masses_are_those_of_the_drawing():
    modulus, shear, density = 72e9, 72e9 / 2.6, 2700.0
    beams = {one.name: one for one in sid.load_study(STUDY).structure.elements if isinstance(one, sid.SpaceBeam)}

    def torsion(wide, thin):
        return shear * wide * thin**3 * (1 / 3 - 0.21 * thin / wide * (1 - (thin / wide) ** 4 / 12))

    for name, wide, high in (
        ("fuselage", 0.05, 0.15),
        ("wing tips", 0.1, 0.01),
        ("drums", 0.1, 0.01),
        ("fin and tailplane", 0.1, 0.01),
    ):
        beam, area = beams[name], wide * high
        told = [
            beam.mass,
            beam.axial_stiffness,
            beam.bending_stiffness_y,
            beam.bending_stiffness_z,
            beam.torsional_stiffness,
            beam.polar_inertia,
        ]
        drawn = [
            density * area, modulus * area, modulus * area * high**2 / 12, modulus * area * wide**2 / 12,
            torsion(max(wide, high), min(wide, high)), density * area * (wide**2 + high**2) / 12,
        ]  # fmt: skip
        np.testing.assert_allclose([np.unique(one)[0] for one in told], drawn, rtol=1e-5)
    layer, distance = 0.0762e-3, 6.6e-3
    together = 1e-3 * layer / (1e-3 + layer)
    assert beams["wing"].bending_stiffness_y[0] == pytest.approx(
        600 + modulus * (together * distance**2 + layer * 1e-6 / 12), rel=1e-6
    )
    bonded = torsion(0.1, 0.01) + 4 * shear * (0.01e-3 / 0.011) * distance**2 * 0.0762
    assert beams["wing"].torsional_stiffness[0] == pytest.approx(bonded, rel=1e-5)
    assert beams["wing"].mass[0] == pytest.approx(density * (1e-3 + layer), rel=1e-6)


def differences(at=None):
    """Relative errors of all frequencies; the close pair of torsion modes is paired by symmetry."""
    parts = {part.name: part for part in correlate(sid.load_study(STUDY), at=at).modes}
    torsion = parts["wing torsion"]
    assert torsion.n_paired == 2
    for i, measured in enumerate(torsion.measured.frequency):
        k = torsion.pairing.number[i]
        right, left = torsion.seen[[0, 2], k]
        assert np.sign(right * left) == SIGNS[measured]
        assert torsion.pairing.mac[i, k] > 0.95
    return np.concatenate([part.frequency_difference for part in parts.values()])


def test_eight_frequencies_after_updating(tmp_path):
    done = CliRunner().invoke(app, ["identify", str(STUDY), "--out", str(tmp_path), "--no-report", "--no-explain"])
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "estimate.json").read_text())
    assert found["verdict"] == "sound"
    before, after = differences(), differences(tmp_path)
    assert len(before) == len(after) == 8
    assert 0.09 < np.abs(before).max() < 0.12
    assert np.abs(after).max() < 0.008
    values = {one["name"]: (one["value"], one["std"]) for one in found["parameters"]}
    bending, torsion = values["bending_stiffness_y[wing]"], values["torsional_stiffness[wing]"]
    assert (bending[0] - 600.0) / 222.523 == pytest.approx(0.72, abs=0.03)
    assert (torsion[0] - 864.924) / 334.25 == pytest.approx(0.20, abs=0.03)
