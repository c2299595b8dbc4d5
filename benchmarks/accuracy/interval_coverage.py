"""Coverage of the 95 % intervals of every estimator and every kind of interval; every repeat counts.

A chain of four masses with known truth, and an oscillator for intervals that take many refits. Each repeat draws new
noise (and where stated model error or truth) with its own seed, from --seed on. A repeat whose search did not converge, or
whose interval is missing, is a miss for every parameter. Ranks of truths drawn from their priors among samples of the
posterior (Talts et al. 2018) are compared with uniform ones.

    python benchmarks/accuracy/interval_coverage.py [--repeats 400] [--seed 0] [--only CASE ...]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem
from structid.inversion.intervals.bootstrap import bootstrap, bootstrap_repeats
from structid.inversion.intervals.profile import profile
from structid.inversion.intervals.sampling import sample
from structid.records import with_coherence_noise
from structid.unknowns.named_unknowns import Transforms

MASS, STIFFNESS = (1.2, 1.4, 1.6, 1.8), (1000.0, 1100.0, 1200.0, 1300.0)


@dataclass(frozen=True)
class Case:
    """Something repeated: `repeat` gives for each row of the table whether truths are covered, and whether it failed."""

    repeat: Callable[[int], dict[str, tuple[np.ndarray, bool]]]
    rows: dict[str, tuple[str, str]]
    share: float = 1.0


AIM, SHOWN = "93 to 97", "shown only"
FREE = ("m1", "m3", "k1", "k2", "k4", "c1")


def chain(prior: float = 0.0):
    """A chain of four masses and the parameters of it that are free, at their true values."""
    parts: list = [sid.PointMass(f"m{i}", [i], MASS[i - 1]) for i in (1, 2, 3, 4)]
    springs = [(f"{i}X", f"{i - 1}X" if i > 1 else None) for i in (1, 2, 3, 4)]
    parts += [sid.Spring(f"k{i}", a, second=b, stiffness=STIFFNESS[i - 1]) for i, (a, b) in enumerate(springs, 1)]
    parts += [sid.Dashpot("c1", "1X", viscous_damping=4.0), sid.Dashpot("c4", "4X", second="3X", viscous_damping=2.0)]
    structure = sid.Structure({i: float(i) for i in (1, 2, 3, 4)}, parts, active=["X"])
    kinds = {"m": "mass", "k": "stiffness", "c": "viscous_damping"}
    unknowns = [sid.Unknown(kinds[name[0]], name) for name in FREE]
    made = sid.parameters(structure, unknowns)
    if prior:
        unknowns = [replace(u, prior=sid.Prior(v, prior * v)) for u, v in zip(unknowns, made.start, strict=True)]
        made = sid.parameters(structure, unknowns)
    return structure, made


def twin(structure, truth, noise, rng, sensors=("1X", "3X"), n_lines=40):
    """Noisy record of the chain, noise in proportion to each value."""
    frequency = np.linspace(0.5, 11.0, n_lines)
    like = sid.FrfRecord(frequency, np.ones((n_lines, len(sensors), 1)), sensors, ["2X"], "receptance")
    return sid.simulated_record(structure, truth, like, noise, rng)


def inside(ends, truth, found) -> tuple[np.ndarray, bool]:
    """Whether each interval holds the truth, and whether the repeat counts as failed."""
    stopped = found.status is sid.Status.NOT_CONVERGED
    hits = (ends[:, 0] <= truth) & (truth <= ends[:, 1]) & (not stopped)
    return hits, stopped or bool(np.isnan(ends).any())


def frf(name, form="output", noise=0.02, prior=0.0):
    def repeat(seed):
        rng = np.random.default_rng(seed)
        structure, truth = chain()
        believed = truth
        if prior:  # the truth is drawn from the prior, which is centred on the nominal values
            _, believed = chain(prior)
            truth = truth.started_at(truth.start * (1 + prior * np.clip(rng.standard_normal(truth.n_params), -4, 4)))
        record = twin(structure, truth, noise, rng)
        begun = believed.start * np.exp(0.02 * rng.standard_normal(truth.n_params))
        found = sid.estimate(sid.FrfProblem(structure, believed.started_at(begun), record, form))
        return {name: inside(found.interval(), truth.start, found)}

    return repeat


def averaged(name, n):
    """Noise from the coherence of n averages of random loads, as a laboratory has it."""

    def repeat(seed):
        rng = np.random.default_rng(seed)
        structure, truth = chain()
        like = twin(structure, truth, 0.0, rng)
        load, noise = ((rng.standard_normal((2, n, *like.values.shape))) for _ in range(2))
        load, noise = (load[0] + 1j * load[1])[..., :1, :], noise[0] + 1j * noise[1]
        motion = like.values * load + 0.02 * np.sqrt(n) * np.abs(like.values) * noise
        xx, yy = (np.abs(load) ** 2).sum(axis=0), (np.abs(motion) ** 2).sum(axis=0)
        xy = (motion * load.conj()).sum(axis=0)
        record = replace(like, values=xy / xx, coherence=np.abs(xy) ** 2 / (xx * yy), averages=n)
        found = sid.estimate(sid.FrfProblem(structure, truth, with_coherence_noise(record)))
        return {name: inside(found.interval(), truth.start, found)}

    return repeat


def model_error(name, sensors, gains=0.0):
    """Smooth error of the model, 5 % of each value and correlated over some lines, above 1 % of noise; both covariances.

    `gains` adds a constant error of each channel.
    """

    def repeat(seed):
        rng = np.random.default_rng(seed)
        structure, truth = chain()
        record, n = twin(structure, truth, 0.01, rng, sensors, 160), len(sensors)
        kernel = np.exp(-0.5 * (np.arange(-9, 10) / 3.0) ** 2)
        white = rng.standard_normal((2 * n, 160 + len(kernel) - 1))
        smooth = np.array([np.convolve(part, kernel / np.linalg.norm(kernel), "valid") for part in white])
        error = 0.05 * (smooth[:n] + 1j * smooth[n:]).T[:, :, None] / np.sqrt(2)
        error = error + gains * rng.standard_normal((n, 1))
        found = sid.estimate(sid.FrfProblem(structure, truth, replace(record, values=record.values * (1 + error))))
        bases = {f"{name}-noise": "noise", f"{name}-model": "model_error"}
        ends = {
            row: replace(found, spread=replace(found.spread, covariance_basis=basis)).interval()
            for row, basis in bases.items()
        }
        return {row: inside(part, truth.start, found) for row, part in ends.items()}

    return repeat


def motion(name):
    """identify_motion with noise of 5 % on the force, or on the motion."""

    def repeat(seed):
        rng = np.random.default_rng(seed)
        structure, truth = chain()
        n, steps = structure.n_dofs, 400
        fields = [rng.standard_normal((steps, n)) * size for size in (100.0, 5.0, 0.3)]
        laws = ("mass", "damping", "stiffness")
        matrices = [structure.matrix(law, truth.values(truth.start)).toarray() for law in laws]
        force = sum(field @ matrix.T for field, matrix in zip(fields, matrices, strict=True))
        if name == "motion-force":
            force = force + 0.05 * force.std() * rng.standard_normal(force.shape)
        else:
            fields = [field + 0.05 * field.std() * rng.standard_normal(field.shape) for field in fields]
        found = sid.identify_motion(structure, truth, sid.Motion(np.arange(steps) * 0.01, force, *fields))
        return {name: inside(found.interval(), truth.start, found)}

    return repeat


def component(seed):
    """FRFs of a chain whose last mass hangs on a part that is known by its own measured FRFs, with stated errors of 2 %."""
    rng = np.random.default_rng(seed)
    structure, truth = chain()
    frequency = np.linspace(0.5, 11.0, 60)
    s = 2j * np.pi * frequency
    inner = 1 / (
        0.6 * s**2 + 2.0 * s + 900.0
    )  # of a mass on a spring to the ground, by which a second spring holds the chain
    own = (inner + 1 / (700.0 + 0.5 * s))[:, None, None]
    noise = rng.standard_normal(own.shape) + 1j * rng.standard_normal(own.shape)
    parts = [
        sid.MeasuredComponent("part", ["4X"], frequency, y, variance=variance)
        for y, variance in ((own, None), (own * (1 + 0.02 * noise / np.sqrt(2)), (0.02 * np.abs(own)) ** 2))
    ]
    true, known = (replace(structure, measured=(part,)) for part in parts)
    like = sid.FrfRecord(frequency, np.ones((60, 2, 1)), ["1X", "3X"], ["2X"], "receptance")
    record = sid.simulated_record(true, truth, like, 0.01, rng)
    found = sid.estimate(sid.FrfProblem(known, truth, record))
    return {"component": inside(found.interval(), truth.start, found)}


def ground(seed):
    """Output error of two storeys on ground whose motion is known, solved for by steps that are not structid's."""
    from scipy import signal

    rng, rate, n = np.random.default_rng(seed), 25.0, 150
    truth, losses = np.array([2e4, 2e4, 30.0]), 30.0
    stiffness, damping = (np.array([[2.0, -1.0], [-1.0, 1.0]]) * size for size in (2e4, losses))
    moved = rng.standard_normal(n)
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness / 10.0, -damping / 10.0]])
    entry, reads = np.array([[0.0], [0.0], [-1.0], [-1.0]]), np.concatenate([-stiffness, -damping], axis=1) / 10.0
    floors = signal.lsim((state, entry, reads, np.zeros((2, 1))), moved, np.arange(n) / rate, interp=True)[1]
    values = np.column_stack([moved, floors + 0.1 * rng.standard_normal(floors.shape)])
    below, above = ["0X", "1X"], ["1X", "2X"]
    sets = [
        sid.PointMass("floors", [1, 2], 10.0),
        sid.Spring("storeys", below, above, stiffness=2e4),
        sid.Dashpot("losses", below, above, viscous_damping=losses),
    ]
    base = [sid.Base("ground", "0X")]
    structure = sid.Structure(dict.fromkeys(range(3), 0.0), sets, ["0X"], active=["X"], bases=base)
    unknowns = [sid.Unknown("stiffness", "storeys", each=True), sid.Unknown("viscous_damping", "losses")]
    made = sid.parameters(structure, unknowns)
    kinds = ("support_acceleration", "acceleration", "acceleration")
    record = sid.TimeRecord(rate, values, ["0X", *above], kinds, variance=np.array([0.0, 0.1, 0.1]) ** 2)
    found = sid.identify_time(structure, made.started_at(made.start * [1.1, 1.1, 0.7]), record)
    return {"ground": inside(found.interval(), truth, found)}


@dataclass(frozen=True, eq=False)
class Transformed(FreeUnknowns):
    """Unknowns kept in their ranges by transforms, without limits for the search."""

    transforms: Transforms | None = None

    def physical(self, theta):
        return self.transforms.physical(theta)

    def slope(self, theta):
        return self.transforms.slope(theta)


@dataclass(frozen=True, eq=False)
class Oscillator(Problem):
    """Mass (kg), damper (N s/m) and spring (N/m) from a receptance with noise of one size: a `Problem` of its own.

    Small and fast, for intervals that take many refits; priors are Gaussian in physical units.
    """

    measured: np.ndarray
    sigma: float
    transforms: Transforms
    start: np.ndarray
    prior_mean: np.ndarray | None = None
    prior_std: np.ndarray | None = None

    omega = np.linspace(10.0, 60.0, 25)
    rows = DataRows(np.tile(np.arange(25), 2), np.repeat([0, 1], 25))

    @property
    def unknowns(self):
        names, units = ("mass", "damper", "spring"), ("kg", "N s/m", "N/m")
        return Transformed(names, self.transforms.free(self.start), names, units, self.transforms)

    def residual(self, theta):
        return self.linearize(theta).residual

    def linearize(self, theta):
        p = self.physical(theta)
        h = receptance(p)
        change = -(h**2)[:, None] * np.stack([-(self.omega**2), 1j * self.omega, np.ones_like(self.omega)], axis=1)
        data, slope = (h - self.measured) / self.sigma, change * self.slope(theta) / self.sigma
        rows, derivative = [data.real, data.imag], [slope.real, slope.imag]
        if self.prior_mean is not None:
            rows.append((p - self.prior_mean) / self.prior_std)
            derivative.append(np.diag(self.slope(theta) / self.prior_std))
        return Linearization(np.concatenate(rows), np.concatenate(derivative))


def receptance(p):
    omega = Oscillator.omega
    return 1 / (p[2] - omega**2 * p[0] + 1j * omega * p[1])


def oscillator(truth, sigma, rng, bounds=None, prior_std=None, repeats=1):
    """The oscillator with new noise (the mean of `repeats` records); sigma relative to the static receptance."""
    truth, size = np.asarray(truth), sigma / NOMINAL[2]
    noise = rng.standard_normal((repeats, 2, 25)).mean(axis=0) * size
    low, high = np.zeros(3), np.full(3, np.inf)
    kinds = ["log", "log", "log"]
    if bounds is not None:
        kinds[1], low[1], high[1] = "interval", *bounds
    measured = receptance(truth) + noise[0] + 1j * noise[1]
    transforms = Transforms(tuple(kinds), low, high)
    prior = (None, None) if prior_std is None else (NOMINAL, prior_std * NOMINAL)
    return Oscillator(measured, size / np.sqrt(repeats), transforms, truth, *prior)


NOMINAL = np.array([1.0, 4.0, 1000.0])
NEAR, WEAK = ((1.0, 3.9, 1000.0), 0.1, (2.0, 4.0)), ((1.0, 0.5, 1000.0), 3.0, None)


def hard(name, setting):
    """The damper alone, where it is hardly seen or lies near a bound, by three kinds of interval."""
    truth, sigma, bounds = setting

    def repeat(seed):
        problem = oscillator(truth, sigma, np.random.default_rng(seed), bounds)
        found = sid.estimate(problem)
        item = profile(problem, found, "damper")
        straight = found.values[1] + found.std[1] * np.array([-1.959964, 1.959964])
        kinds = {"linear": straight, "laplace": found.interval()[1], "profile": (item.lower, item.upper)}
        results = {}
        for kind, (low, high) in kinds.items():
            missing = bool(np.isnan([low, high]).any())
            results[f"{name}-{kind}"] = np.array([low <= truth[1] <= high]), missing
        return results

    return repeat


def boot(seed):
    """Bootstrap of the noise, all three parameters, damper seen to about 20 %."""
    rng = np.random.default_rng(seed)
    problem = oscillator(NOMINAL, 0.4, rng)
    found = sid.estimate(problem)
    return {"bootstrap": inside(bootstrap(problem, found, "noise", 200, rng).interval(), NOMINAL, found)}


def repeats(seed):
    """Twelve repeated records, refitted to draws of eleven: no noise level is used."""
    rng = np.random.default_rng(seed)
    measured = [oscillator(NOMINAL, 0.4, rng) for _ in range(12)]

    def refit(chosen):
        return sid.estimate(replace(chosen[0], measured=np.mean([record.measured for record in chosen], axis=0)))

    ends = bootstrap_repeats(measured, refit, 200, rng).interval()
    return {"repeats": ((ends[:, 0] <= NOMINAL) & (ends[:, 1] >= NOMINAL), bool(np.isnan(ends).any()))}


def sampled(seed):
    """Samples where the damper is seen to about 20 %; flat priors in physical units."""
    rng = np.random.default_rng(seed)
    problem = oscillator(NOMINAL, 0.4, rng)
    found = sid.estimate(problem)
    return {"sampling": inside(sample(problem, found, 300, n_warmup=150, rng=rng).interval(), NOMINAL, found)}


def ranks(seed):
    """Ranks, 0 to 99, of a truth drawn from its prior (20 %) among 99 thinned draws; damper seen to about as much."""
    rng = np.random.default_rng(seed)
    truth = NOMINAL * (1 + 0.2 * np.clip(rng.standard_normal(3), -4.5, 4.5))
    problem = oscillator(truth, 1.6, rng, prior_std=0.2)
    drawn = sample(problem, sid.estimate(problem), 300, n_warmup=150, rng=rng)
    picked = drawn.samples.reshape(-1, 3)[np.linspace(0, 1199, 99).astype(int)]
    return {"ranks": (np.count_nonzero(picked < truth, axis=0), not drawn.is_reliable)}


CASES = {
    "frf": Case(frf("frf"), {"frf": ("FRF of a chain, maximum likelihood (output form), Laplace", AIM)}),
    "frf-log": Case(frf("frf-log", "log"), {"frf-log": ("the same, log form", AIM)}),
    "averages-5": Case(
        averaged("averages-5", 5),
        {"averages-5": ("the same chain, noise from the coherence of 5 averages", "93 or more")},
    ),
    "averages-15": Case(averaged("averages-15", 15), {"averages-15": ("the same of 15 averages", AIM)}),
    "prior": Case(
        frf("prior", noise=0.2, prior=0.02), {"prior": ("the same, priors of 2 %, the truth drawn from them", AIM)}
    ),
    "error": Case(
        model_error("error", ("1X", "3X")),
        {
            "error-noise": ("correlated model error, two sensors, covariance of the noise", SHOWN),
            "error-model": ("correlated model error, two sensors, covariance that carries it", AIM),
        },
    ),
    "error-four": Case(
        model_error("four", ("1X", "2X", "3X", "4X")),
        {
            "four-noise": ("the same, four sensors, covariance of the noise", SHOWN),
            "four-model": (
                "the same, four sensors (channels are blocks too), covariance that carries it",
                "93 or more",
            ),
        },
    ),
    "error-gains": Case(
        model_error("gains", ("1X", "2X", "3X", "4X"), 0.05),
        {
            "gains-noise": ("the same and gains wrong by 5 %, covariance of the noise", SHOWN),
            "gains-model": ("the same and gains wrong by 5 %, covariance that carries it", "93 or more"),
        },
    ),
    "motion": Case(motion("motion-force"), {"motion-force": ("identify_motion, noise on the force", AIM)}),
    "motion-bias": Case(
        motion("motion-motion"), {"motion-motion": ("identify_motion, noise on the motion: biased", SHOWN)}
    ),
    "component": Case(component, {"component": ("FRFs, a measured component with stated errors of 2 %", AIM)}),
    "ground": Case(ground, {"ground": ("output error, ground whose motion is known", AIM)}),
    "near": Case(
        hard("near", NEAR),
        {
            "near-linear": ("damper near its upper bound, value -+ 1.96 std", SHOWN),
            "near-laplace": ("damper near its upper bound, Laplace", SHOWN),
            "near-profile": ("damper near its upper bound, profile", AIM),
        },
    ),
    "weak": Case(
        hard("weak", WEAK),
        {
            "weak-linear": ("damper hardly seen, value -+ 1.96 std", SHOWN),
            "weak-laplace": ("damper hardly seen, Laplace in the logarithm", SHOWN),
            "weak-profile": ("damper hardly seen, profile", AIM),
        },
    ),
    "bootstrap": Case(boot, {"bootstrap": ("bootstrap of the noise, 200 replicates", AIM)}, 0.25),
    "repeats": Case(repeats, {"repeats": ("bootstrap of 12 repeats, 200 replicates", AIM)}, 0.25),
    "sampling": Case(sampled, {"sampling": ("samples", AIM)}, 0.15),
    "ranks": Case(ranks, {"ranks": ("samples, ranks of simulated truths", "p above 0.01")}, 0.15),
}


def rank_probability(found: np.ndarray) -> float:
    """Of a larger chi-square of the ranks in ten bins, all parameters together."""
    from scipy import stats

    counts = np.histogram(found.ravel(), bins=np.linspace(-0.5, 99.5, 11))[0]
    return float(stats.chisquare(counts).pvalue)


def line(name: str, words: str, aim: str, results: list[tuple[np.ndarray, bool]], first: int) -> str:
    """One row of the table."""
    hits, failed = np.array([r[0] for r in results]), [first + k for k, r in enumerate(results) if r[1]]
    if name == "ranks":
        figures = f"p = {rank_probability(hits):.2g} that ranks are uniform"
    else:
        each = 100 * hits.mean(axis=0)
        figures = f"{100 * hits.mean():7.2f}     {each.min():6.1f} to {each.max():5.1f}"
    shown = f"; failed {failed}" if failed else ""
    return f"{name:14s} {len(results):4d}  {figures:36s} {len(failed):4d}    {aim:12s}  {words}{shown}"


def main() -> None:
    """Print one line for each kind of interval."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=list(CASES), default=list(CASES))
    chosen = parser.parse_args()
    print(f"seeds from {chosen.seed} on; a missing interval or a search that did not converge counts as a miss")
    print("case         repeats  coverage %  by parameter %       failed  aim %")
    for name in chosen.only:
        case, begun = CASES[name], time.process_time()
        count = max(round(chosen.repeats * case.share), 1)
        results = [case.repeat(chosen.seed + k) for k in range(count)]
        for row, (words, aim) in case.rows.items():
            print(line(row, words, aim, [result[row] for result in results], chosen.seed), flush=True)
        print(f"    {time.process_time() - begun:.0f} s of processor time", flush=True)


if __name__ == "__main__":
    main()
