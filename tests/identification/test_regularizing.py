"""Smoothness, sparsity and priors in an identification, from Python and from a study file."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import structid as sid
from structid.cli import app as cli
from structid.study.schema.study import load_study
from study_cases import CHAIN, replaced, write_chain

N = 12
#: A stiffness that varies smoothly, by a third up and down.
SMOOTH = 3.0 * np.exp(0.3 * np.sin(2 * np.pi * np.arange(N) / (N - 1)))


def free_beam():
    beam = sid.Beam("beam", [[i, i + 1] for i in range(N)], 4.0, 3.0, loss_factor=0.01)
    structure = sid.Structure({i: float(i) for i in range(N + 1)}, [beam])
    return structure, sid.parameters(structure, [sid.Unknown("bending_stiffness", "beam", each=True)])


def measured(structure, truth, sensors, noise, seed, highest=0.45):
    frequency = np.geomspace(0.012, highest, 40)
    like = sid.FrfRecord(frequency, np.ones((40, len(sensors), 1)), sensors, ("0Y",), "receptance")
    noisy = sid.simulated_record(structure, truth, like, noise, np.random.default_rng(seed))
    return sid.with_declared_noise(noisy, relative=noise)


def error(found, truth):
    return float(np.sqrt(np.mean(np.log(found.estimate.values / truth.start) ** 2)))


@pytest.mark.parametrize("rule", ["marginal_likelihood", "l_curve", "discrepancy", 100.0])
def test_smoothness_recovers_every_element_where_two_noisy_sensors_alone_do_not(rule):
    structure, unknown = free_beam()
    truth = unknown.started_at(SMOOTH)
    record = measured(structure, truth, ("0Y", f"{N}Y"), 0.1, 3, 0.08)
    options = sid.IdentifyOptions(regularization=[sid.Smoothness("bending_stiffness", "beam", rule)], restarts=0)
    found = sid.identify(structure, unknown, record, options)
    assert found.estimate.status is sid.Status.CONVERGED
    assert error(found, truth) < 0.1
    (held,) = found.priors.regularizations
    assert held.converged
    assert held.rule == ("given" if rule == 100.0 else rule)
    assert found.warnings.count(held.words) == 1
    assert f"strength {held.strengths[0]:.3g}" in held.words
    assert ((found.priors.variance_fraction >= 0) & (found.priors.variance_fraction <= 1)).all()
    assert any("parameters are held by smoothness of bending_stiffness[beam]" in w for w in found.warnings)
    if rule == "discrepancy":
        n = found.problem.n_data
        # the strength is chosen with the noise of the measured sizes, the last fit has it of the model's
        assert found.estimate.goodness.chi_square == pytest.approx(n + np.sqrt(2 * n), abs=0.15 * np.sqrt(2 * n))
    elif rule == 100.0:
        assert (held.strengths == 100.0).all()


def test_plain_least_squares_fails_where_smoothness_recovers():
    structure, unknown = free_beam()
    truth = unknown.started_at(SMOOTH)
    record = measured(structure, truth, ("0Y", f"{N}Y"), 0.1, 3, 0.08)
    found = sid.identify(structure, unknown, record, sid.IdentifyOptions(restarts=0))
    assert found.estimate.status is sid.Status.NOT_IDENTIFIABLE
    assert error(found, truth) > 1
    assert found.priors.regularizations == ()
    assert found.priors.variance_fraction == pytest.approx(np.zeros(N))


@pytest.mark.parametrize(("strength", "most"), [("marginal_likelihood", 4), (50.0, 9)])
def test_sparsity_locates_one_damage_with_one_noisy_sensor(strength, most):
    structure, unknown = free_beam()
    values = np.full(N, 3.0)
    values[6] *= 0.85
    record = measured(structure, unknown.started_at(values), ("4Y",), 0.05, 1)
    options = sid.IdentifyOptions(regularization=[sid.Sparsity("bending_stiffness", "beam", strength)])
    found = sid.identify(structure, unknown, record, options)
    change = np.abs(found.estimate.values / 3.0 - 1)
    assert change.argmax() == 6
    assert change[6] == pytest.approx(0.15, abs=0.03)
    assert np.delete(change, 6).max() < 0.03
    assert found.priors.regularizations[0].n_free <= most
    assert (
        f"{found.priors.regularizations[0].n_free} of 12 parameters leave their start"
        in found.priors.regularizations[0].words
    )
    assert found.priors.regularizations[0].converged


TERM = '[[regularization]]\nkind = "smoothness"\nproperty = "mass"\nelements = ["mass 1", "mass 2"]\nstrength = 4.0\n'


def with_term(old, new):
    return CHAIN.replace("[record]", replaced(old, new, TERM) + "\n[record]", 1)


def test_study_file_states_terms_and_results_tell_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = CHAIN.replace(
        "[record]", '[[regularization]]\nkind = "sparsity"\nproperty = "stiffness"\nelements = "upper"\n\n[record]', 1
    )
    text = replaced(
        'elements = "ground"\n',
        'elements = "ground"\nprior = { mean = 990.0, relative_std = 0.1, kind = "lognormal" }\n',
        text,
    )
    path = write_chain(tmp_path, text)
    study = load_study(path)
    assert study.options.regularization == (sid.Sparsity("stiffness", "upper"),)
    place = study.parameters.names.index("stiffness[ground]")
    assert study.parameters.priors.std[place] == pytest.approx(99.0)
    assert study.parameters.priors.lognormal.tolist() == [i == place for i in range(study.parameters.n_params)]
    predicted = CliRunner().invoke(cli.app, ["check", str(path)])
    assert "predicted without the sparsity of stiffness[upper] that `identify` will use" in predicted.stdout
    done = CliRunner().invoke(cli.app, ["identify", str(path), "--no-report", "--verbose"])
    assert done.exit_code == 0
    assert "sparsity of stiffness[upper], chosen by marginal likelihood: 2 of 2 parameters leave" in done.stdout
    stored = json.loads((tmp_path / "chain_results" / "estimate.json").read_text())
    (term,) = stored["regularization"]
    assert (term["rule"], term["settled"], len(term["strengths"])) == ("marginal_likelihood", True, 2)
    assert term["text"] in stored["warnings"]
    assert stored["provenance"]["settings"]["regularization"] == [
        {"kind": "sparsity", "property": "stiffness", "elements": "upper", "strength": "marginal_likelihood"}
    ]
    shares = {entry["name"]: entry["prior_share"] for entry in stored["parameters"]}
    assert all(0 <= share <= 1 for share in shares.values())
    assert shares["stiffness[ground]"] > 0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('kind = "smoothness"', 'kind = "smooth"', ["[[regularization]]", "kind", '"sparsity"']),
        ("strength = 4.0", "strength = 0.0", ["strength", "a number greater than 0 or one of"]),
        ("strength = 4.0", 'strength = "l_curves"', ["strength", '"l_curve"']),
        ("strength = 4.0", "strenght = 4.0", ["unknown key", "`strength`"]),
        ('property = "mass"\n', "", ["`property` is missing"]),
        ('"mass 2"', '"masss 2"', ["there is no element set 'masss 2'"]),
        ("strength = 4.0", "", ["share a node"]),
    ],
)
def test_unusable_terms_of_a_study_are_told_with_their_place(tmp_path, old, new, words):
    text = with_term(old, new)
    with pytest.raises(sid.InputError) as caught:
        load_study(write_chain(tmp_path, text))
    message = str(caught.value)
    assert "chain.toml, line" in message
    for word in words:
        assert word in message


def test_a_prior_takes_one_of_two_widths(tmp_path):
    both = 'prior = { mean = 1.0, std = 0.1, relative_std = 0.1 }\nelements = "ground"\n'
    for prior in (both, both.replace("std = 0.1, relative_std = 0.1", 'kind = "normal"')):
        with pytest.raises(sid.InputError, match="either `std` or `relative_std`"):
            load_study(write_chain(tmp_path, replaced('elements = "ground"\n', prior)))
