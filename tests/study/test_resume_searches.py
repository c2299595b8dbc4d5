"""Time histories fitted as such, and chains of samples: on several processes, killed and resumed, to the same bits."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from test_checkpoint import OWNER, Stopped, Stopping, command, signalled_when
from test_study_time import CHAIN as TIME_CHAIN
from test_study_time import sampled_record, write_study

from short_record_cases import RATE, chain, unknowns
from structid import TimeRecord
from structid.dynamics.transient import sampled_transient
from structid.forward import TimeOptions
from structid.forward.time.identify_time import _furthest, _search_starts, _Start, identify_time
from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem
from structid.inversion.estimate import estimate
from structid.inversion.intervals.nuts import begun, continued
from structid.inversion.intervals.sampling import sample
from structid.study.run.long_run import Checkpoint, LongRun, checkpoint_folder, fingerprint
from structid.study.run.run import run_study
from structid.study.run.workers import Processes
from structid.study.schema.study import load_study

OUTPUT_ERROR = TIME_CHAIN.replace("relative_noise = 0.01", 'fit = "output_error"\nrelative_noise = [0.0, 0.01, 0.01]')
OUTPUT_ERROR = OUTPUT_ERROR.replace("band = [0.1, 12.0]", "restarts = 3")


def stopped_over_and_over(folder: Path, owner, run, after: list[int]):
    """What `run` gives when it is stopped after so many things that its checkpoint took, and resumed; the stops."""
    for stops, count in enumerate([*after, 10**9]):
        kept = Stopping(folder, owner, resume=stops > 0, seconds=0.0, after=count)
        try:
            return run(LongRun(checkpoint=kept)), stops
        except Stopped:
            continue
    raise AssertionError


def same_estimate(one, two) -> None:
    for name in ("theta", "covariance"):
        assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True), name
    assert np.array_equal(one.search.history, two.search.history)
    assert (one.search.n_starts, one.search.n_iterations) == (two.search.n_starts, two.search.n_iterations)
    assert one.goodness.chi_square == two.goodness.chi_square


@pytest.fixture(scope="module")
def histories(tmp_path_factory):
    """A study by output error whose record no model fits, so that all starts are tried; and its answer."""
    record = sampled_record()
    bent = TimeRecord(RATE, record.values[:60] + 0.0, record.channels, record.quantities)
    bent.values.flags.writeable = True
    bent.values[:, 1] *= 1 + 0.05 * np.sin(np.arange(60))
    path, _ = write_study(tmp_path_factory.mktemp("time"), OUTPUT_ERROR, bent)
    study = load_study(path)
    return study, run_study(study).identification.estimate


@pytest.mark.long
def test_output_error_stopped_anywhere_resumes_to_the_same_bits(histories, tmp_path):
    study, whole = histories
    assert whole.search.n_starts >= 4
    found, stops = stopped_over_and_over(
        tmp_path / "c", fingerprint(study), lambda run: run_study(study, None, run), [3, 17, 9]
    )
    assert stops == 3
    same_estimate(found.identification.estimate, whole)


@pytest.mark.long
def test_output_error_on_processes_has_the_bits_of_one(histories):
    study, whole = histories
    pool = Processes(2)
    found = run_study(study, None, LongRun(pool)).identification.estimate
    pool.close()
    assert found.search.n_starts == whole.search.n_starts
    same_estimate(found, whole)


def test_a_kept_search_is_not_done_again(histories, tmp_path):
    """Resumed after everything is done: one linearization for each search that is restored, and no iteration."""
    study, whole = histories
    kept = Checkpoint(tmp_path / "c", fingerprint(study), seconds=0.0)
    run_study(study, None, LongRun(checkpoint=kept))
    again = Checkpoint(tmp_path / "c", fingerprint(study), resume=True, seconds=0.0)
    told: list[str] = []
    same_estimate(
        run_study(study, lambda *words: told.append(words[0]), LongRun(checkpoint=again)).identification.estimate, whole
    )
    assert told == []


def everything_measured() -> TimeRecord:
    """Displacement, velocity and acceleration of all four masses, with noise, and the force."""
    structure = chain()
    values = unknowns(structure).values(unknowns(structure).start)
    mass, damping, stiffness = (structure.matrix(law, values) for law in ("mass", "damping", "stiffness"))
    rng = np.random.default_rng(4)
    force = rng.standard_normal((400, 1))
    motion = sampled_transient(mass, stiffness, np.eye(4)[:, 3:], force, RATE, damping)
    table = np.column_stack([force, motion.displacement, motion.velocity, motion.acceleration])
    std = np.array([0.0, *[0.02] * 12]) * np.sqrt((table**2).mean(axis=0))
    kinds = ["force", *np.repeat(["displacement", "velocity", "acceleration"], 4).tolist()]
    channels = ("4X", *("1X", "2X", "3X", "4X") * 3)
    return TimeRecord(RATE, table + std * rng.standard_normal(table.shape), channels, kinds, variance=std**2)


def test_instruments_stopped_anywhere_go_on_to_the_same_bits(tmp_path, monkeypatch):
    """Solutions of the run before are taken as they are: rows are made for the others only, and once at the end."""
    record, structure = everything_measured(), chain()
    unknown = unknowns(structure).started_at(unknowns(structure).start * 1.3)
    options = TimeOptions(method="instrumental", first_samples=30)
    whole = identify_time(structure, unknown, record, options)
    assert whole.status.value == "converged"
    from structid.forward.time.instrumental import InstrumentalFit

    made, rows = [], InstrumentalFit.rows
    monkeypatch.setattr(InstrumentalFit, "rows", lambda fit, values: made.append(1) or rows(fit, values))
    found, stops = stopped_over_and_over(
        tmp_path / "c", OWNER, lambda run: identify_time(structure, unknown, record, options, run), [2, 5]
    )
    assert stops == 2
    same_estimate(found, whole)
    n_steps = len(whole.search.history) - 1
    assert n_steps > 7
    assert len(made) <= n_steps + 3


class Bowl(Problem):
    """Two parameters of which one enters as its cube, so that the chains have something to turn."""

    unknowns = FreeUnknowns(("p", "q"), np.array([0.5, 0.5]))
    rows = DataRows(np.arange(3), np.zeros(3, dtype=int))

    def residual(self, theta):
        return np.array([theta[0] - 1.0, 2 * theta[1] - theta[0], 0.3 * theta[1] ** 3])

    def linearize(self, theta):
        return Linearization(self.residual(theta), np.array([[1.0, 0.0], [-1.0, 2.0], [0.0, 0.9 * theta[1] ** 2]]))


def chains(work=None):
    problem = Bowl()
    given = {} if work is None else {"work": work}
    rng = np.random.default_rng(3)
    return sample(problem, estimate(problem), n_draws=120, n_chains=3, n_warmup=60, rng=rng, **given)


def test_chains_stopped_anywhere_and_on_processes_have_the_bits_of_one_run(tmp_path):
    whole = chains()
    found, stops = stopped_over_and_over(tmp_path / "c", OWNER, chains, [2, 4, 1])
    assert stops == 3
    pool = Processes(2)
    shared = chains(LongRun(pool))
    pool.close()
    for other in (found, shared):
        assert np.array_equal(other.samples, whole.samples)
        assert (other.n_evaluations, other.n_divergent) == (whole.n_evaluations, whole.n_divergent)


@pytest.mark.parametrize("lengths", [(0, 90), (61, 40), (3, 5), (100, 0)])
@pytest.mark.parametrize("piece", [1, 7, 50])
def test_a_chain_in_pieces_has_the_bits_of_one_at_once(lengths, piece):
    """Across both changes of the coordinates, and with its generator taken from its state."""
    n_warmup, n_draws = lengths

    def density(x):
        at = Bowl().linearize(x)
        return -0.5 * float(at.residual @ at.residual), -at.jacobian.T @ at.residual

    start = begun(density, np.ones(2))
    whole, every = continued(density, start, n_warmup, n_draws, n_warmup + n_draws, np.random.default_rng(1))
    rng, state, kept = np.random.default_rng(1), start, []
    for _ in range(-(-(n_warmup + n_draws) // piece)):
        known = rng.bit_generator.state
        rng = np.random.default_rng()
        rng.bit_generator.state = known
        state, draws = continued(density, state, n_warmup, n_draws, piece, rng)
        kept.append(draws)
    assert np.array_equal(np.concatenate(kept) @ state.factor.T, every @ whole.factor.T)
    assert (state.n_gradients, state.n_divergent) == (whole.n_gradients, whole.n_divergent)


def test_a_chain_goes_on_from_its_place_when_its_coordinates_turn():
    """30 draws of a phase of 30 end where 30 of a longer one do, seen in other coordinates."""

    def density(x):
        at = Bowl().linearize(x)
        return -0.5 * float(at.residual @ at.residual), -at.jacobian.T @ at.residual

    def place(n_warmup):
        rng = np.random.default_rng(2)
        return continued(density, begun(density, np.ones(2)), n_warmup, 10, 30, rng)[0]

    turned, longer = place(60), place(200)
    assert (turned.phase, turned.done, longer.phase, longer.done) == (1, 0, 0, 30)
    assert not np.allclose(turned.factor, np.eye(2))
    assert turned.factor @ turned.at.x == pytest.approx(longer.at.x, rel=1e-12)
    assert turned.at.log_density == pytest.approx(longer.at.log_density, rel=1e-12)


def test_the_step_size_is_set_to_accept_four_of_five():
    """On a normal density of twelve parameters; without adaptation it is 0.5."""

    def density(x):
        return -0.5 * float(x @ x), -x

    found, _ = continued(density, begun(density, np.ones(12)), 400, 400, 800, np.random.default_rng(0))
    assert found.acceptance / 400 == pytest.approx(0.8, abs=0.08)
    assert np.exp(found.step.log_mean) > 0.55


def test_of_ways_that_came_as_far_the_one_with_the_least_misfit_is_followed():
    """What a task says of a way becomes a key of which the largest is the best."""

    class Told:
        n_workers = 2

        def map(self, name, task, shared, items, progress=None, first=0):
            return [{"reached": 3, "excess": 2.0 + item.theta[0], "theta": item.theta, "spent": 5} for item in items]

    starts = [_Start(np.array([float(k)])) for k in (4, 1, 7)]
    ways = [way for way, _ in _search_starts(iter([starts]), (None, [], None), Told(), None)]
    assert [way[:2] for way in ways] == [(3, -6.0), (3, -3.0), (3, -9.0)]
    assert _furthest(ways)[2] == 1.0


def test_pieces_of_a_chain_are_kept_before_it_ends(tmp_path):
    """A run that ends among the draws has those before in its checkpoint."""
    kept = Stopping(tmp_path / "c", OWNER, seconds=0.0, after=7)
    with pytest.raises(Stopped):
        chains(LongRun(checkpoint=kept))
    names = list(Checkpoint(tmp_path / "c", OWNER, resume=True).entries)
    assert names[:2] == ["chains to draw 50 of 180 1, 1", "chains to draw 50 of 180 1, 2"]
    assert names[-1] == "chains to draw 150 of 180 1, 1"


@pytest.mark.long
def test_a_killed_time_fit_resumes_to_the_same_digits(histories, tmp_path):
    """Killed by SIGKILL in one of its searches."""
    source = histories[0].path.parent
    for name in ("whole", "killed"):
        shutil.copytree(source, tmp_path / name / "study")
        (tmp_path / name / "study" / "study.toml").rename(tmp_path / name / "study" / "chain.toml")
    first = command(tmp_path / "whole")
    first.communicate(timeout=600)
    kept = checkpoint_folder(tmp_path / "killed" / "chain_results")
    second = command(tmp_path / "killed", "--checkpoint", "0")
    signalled_when(second, kept / "done-00004.npz", signal.SIGKILL)
    assert second.returncode == -signal.SIGKILL
    third = command(tmp_path / "killed", "--resume")
    third.communicate(timeout=600)
    assert first.returncode == third.returncode
    one, two = (
        json.loads((tmp_path / name / "chain_results" / "estimate.json").read_text()) for name in ("whole", "killed")
    )
    assert one == two
    assert one["parameters"][0]["value"] > 0
