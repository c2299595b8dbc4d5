"""Samples from the posterior: by the no-U-turn sampler with exact gradients, or by emcee; and diagnostics of their chains."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError, SingularModelError
from structid.inversion.covariance import fit_covariance
from structid.inversion.estimate import Estimate, require_level
from structid.inversion.intervals import WITH_EXTRA
from structid.inversion.intervals.nuts import begun, continued, restored
from structid.inversion.problem import Problem, few_averages
from structid.inversion.search.least_squares import StoredValues
from structid.inversion.search.work import SERIAL, TaskContext, TaskExecutor

SamplerKind = Literal["nuts", "emcee"]
FlatIn = Literal["physical", "free"]

_LARGEST_R_HAT = 1.01
_FEWEST_EFFECTIVE = 400.0
_MOST_DIVERGENT = 0.01
_AT_ONCE = 50  # draws between two states that are kept


@dataclass(frozen=True, eq=False)
class Samples:
    """Draws from a posterior, with what tells whether to trust them.

    Attributes
    ----------
    names, units : tuple of str
    samples : (n_chains, n_draws, n_params) float array
        Physical units.
    stretched : bool
        Whether the draws were stretched about the estimate to its covariance, which carries model error or few averages.
    r_hat, bulk_size, tail_size : (n_params,) float arrays
        Rank-normalized split R-hat, and effective sample sizes for the centre and for the tails.
    n_divergent : int
        Trajectories that broke down; always 0 with emcee.
    n_evaluations : int
        Of the model, over all chains, warm-up included.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    samples: FloatArray
    stretched: bool
    r_hat: FloatArray
    bulk_size: FloatArray
    tail_size: FloatArray
    n_divergent: int
    n_evaluations: int

    def drawn(self, n_draws: int, rng: np.random.Generator) -> FloatArray:
        """All draws, (n_chains, n_draws, n_params), physical units; `n_draws` and `rng` are not used."""
        return self.samples

    @property
    def words(self) -> tuple[str, ...]:
        """Reasons not to trust the samples: chains that disagree, too few independent draws, divergent trajectories.

        Empty if there are none.
        """
        said = []
        worst = int(np.argmax(np.where(np.isfinite(self.r_hat), self.r_hat, np.inf)))
        if not self.r_hat[worst] <= _LARGEST_R_HAT:
            said.append(
                f"the chains disagree (R-hat {self.r_hat[worst]:.3f} of {self.names[worst]}, at most {_LARGEST_R_HAT}):"
                " draw more; if it stays, the data have several answers or no limit there, and a prior is needed"
            )
        sizes = np.minimum(self.bulk_size, self.tail_size)
        few = int(np.argmin(np.where(np.isfinite(sizes), sizes, -1.0)))
        if not sizes[few] >= _FEWEST_EFFECTIVE:
            said.append(
                f"too few independent draws ({sizes[few]:.0f} of {self.names[few]}, {_FEWEST_EFFECTIVE:.0f} wanted):"
                " draw more"
            )
        drawn = self.samples.shape[0] * self.samples.shape[1]
        if self.n_divergent > _MOST_DIVERGENT * drawn:
            said.append(
                f"{self.n_divergent} of {drawn} trajectories broke down: the posterior has a corner that the sampler"
                " cannot enter; give a prior or bounds"
            )
        return tuple(said)

    @property
    def is_reliable(self) -> bool:
        """True where R-hat is at most 1.01, 400 draws are effective and at most 1 % of the trajectories broke down."""
        return not self.words

    @property
    def covariance(self) -> FloatArray:
        """Covariance (n_params, n_params) of the draws, physical units; NaN where they are not reliable."""
        n_params = len(self.names)
        if not self.is_reliable:
            return np.full((n_params, n_params), np.nan)
        return np.cov(self.samples.reshape(-1, n_params), rowvar=False).reshape(n_params, n_params)

    def interval(self, level: float = 0.95) -> FloatArray:
        """Central posterior interval, (n_params, 2), physical units; NaN where the draws are not reliable, see `words`.

        `level` is the probability of the interval; columns are its lower and upper end. `InputError` if it is not
        between 0 and 1.
        """
        require_level(level)
        n_params = len(self.names)
        if not self.is_reliable:
            return np.full((n_params, 2), np.nan)
        ends = [0.5 - level / 2, 0.5 + level / 2]
        return np.quantile(self.samples.reshape(-1, n_params), ends, axis=0).T


def sample(
    problem: Problem,
    estimate: Estimate,
    n_draws: int = 1000,
    n_chains: int = 4,
    n_warmup: int = 300,
    sampler: SamplerKind = "nuts",
    flat_in: FlatIn = "physical",
    rng: np.random.Generator | None = None,
    work: TaskExecutor = SERIAL,
) -> Samples:
    """Posterior draws of the parameters by Markov chains started around the estimate.

    Parameters
    ----------
    problem : Problem
        Its priors count. Where a parameter has none, see `flat_in`.
    estimate : Estimate
        Of that problem; its noise covariance must be finite.
    n_draws : int
        Draws that are kept of each chain, with emcee of each walker.
    n_chains : int
        With emcee the number of walkers is the larger of this and twice the number of parameters and two.
    n_warmup : int
        Draws before these, which are dropped; with emcee at least as many as are kept.
    sampler : {"nuts", "emcee"}
        emcee needs the extra ``sampling``; its walkers are diagnosed as chains, though they are not quite independent.
    flat_in : {"physical", "free"}
        ``physical``: flat in physical units over the parameter's range, so that declared priors mean what they say.
        ``free``: flat in the free variable, thus in the logarithm of a positive parameter; where the data allow 0 or
        infinity such a posterior cannot be normalized, and the chains show it.
    rng : numpy Generator, optional
        Seed 0 by default. Each chain has random numbers of its own: the answer does not depend on where they run.
    work : TaskExecutor
        Where the chains run, and whether they are kept every 50 draws; emcee runs here, and is not kept.

    Returns
    -------
    Samples
        Where the estimate carries model error, the draws are stretched about it so that, to first order, they have
        its covariance (Shaby 2014).

    Raises
    ------
    InputError
        If the covariance is not finite, `sampler` or `flat_in` is unknown, or emcee is missing.

    Notes
    -----
    One gradient costs one linearization; a draw takes 3 to 7 where the posterior is nearly normal.

    References
    ----------
    Neal (2011), Handbook of MCMC, chapter 5; Hoffman and Gelman (2014), J. Mach. Learn. Res. 15; Foreman-Mackey et al.
    (2013), PASP 125; Shaby (2014), J. Comput. Graph. Stat. 23.
    """
    if sampler not in ("nuts", "emcee"):
        raise InputError(f"`sampler` must be 'nuts' or 'emcee', got {sampler!r}; take 'nuts'")
    if flat_in not in ("physical", "free"):
        raise InputError(f"`flat_in` must be 'physical' or 'free', got {flat_in!r}; take 'physical'")
    few = few_averages(problem.rows.averages)
    factor = _whitening(estimate, None if few is None else fit_covariance(problem, estimate.theta))
    target, counts = _Target(problem, np.array(estimate.theta), factor, flat_in), (n_draws, n_chains, n_warmup)
    rng = rng or np.random.default_rng(0)
    drawn = _by_nuts(target, *counts, rng, work) if sampler == "nuts" else _by_emcee(target, *counts, rng)
    stretched = estimate.covariance_basis == "model_error" or few is not None
    white = drawn.draws @ _covariance_root(estimate, factor) if stretched else drawn.draws
    theta = estimate.theta + white @ factor.T
    with np.errstate(over="ignore"):
        physical = np.array([[problem.physical(t) for t in chain] for chain in theta])
    columns = [theta[:, :, j] for j in range(theta.shape[2])]
    r_hat, bulk, tail = (locked([f(c) for c in columns]) for f in (split_r_hat, bulk_sample_size, tail_sample_size))
    counted = drawn.n_divergent, drawn.n_evaluations
    return Samples(problem.names, problem.unknowns.units, locked(physical), stretched, r_hat, bulk, tail, *counted)


def sampled_ends(
    problem: Problem, estimate: Estimate, level: float, seed: int, work: TaskExecutor
) -> tuple[FloatArray, tuple[str, ...]]:
    """Interval ends (n_params, 2) in physical units from posterior draws, and warnings as a tuple of sentences.

    `level` is the probability of the interval. The ends are NaN if the noise covariance is not finite or the draws are
    not reliable. `seed` fixes the draws. `work` runs the chains.
    """
    if not np.isfinite(estimate.spread.covariance_noise).all():
        none = np.full((len(estimate.names), 2), np.nan)
        return none, ("no samples: the data and priors leave a direction without limit; give a prior or bounds",)
    samples = sample(problem, estimate, rng=np.random.default_rng(seed), work=work)
    return samples.interval(level), samples.words


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Draws (n_chains, n_draws, n_params) in whitened coordinates; counts of divergent trajectories and evaluations."""

    draws: FloatArray
    n_divergent: int
    n_evaluations: int


def _whitening(estimate: Estimate, fitted: FloatArray | None = None) -> FloatArray:
    """Lower Cholesky factor of a covariance (n_params, n_params) of the free variables: `fitted`, else that from noise.

    Raises `InputError` with the names of the parameters if it is not finite.
    """
    slope = np.ones(len(estimate.names)) if estimate.parameters.slope is None else estimate.parameters.slope
    covariance = estimate.spread.covariance_noise / np.outer(slope, slope) if fitted is None else fitted
    if not np.isfinite(covariance).all():
        lost = [n for n, v in zip(estimate.names, np.diag(covariance), strict=True) if not np.isfinite(v)]
        raise InputError(
            f"`estimate` must have a finite covariance, got none for {', '.join(lost)}; tie or fix these, or give a prior"
        )
    return np.linalg.cholesky(covariance)


@dataclass(frozen=True, eq=False)
class _Target:
    """Logarithm of the posterior, 0 at the estimate, and its gradient, in whitened coordinates about the estimate."""

    problem: Problem
    centre: FloatArray
    factor: FloatArray
    flat_in: FlatIn

    @cached_property
    def _at_centre(self) -> tuple[float, float]:
        """Sum of squares at the centre, and the sum of the logarithms of the magnitudes of all slopes there.

        A slope is the derivative of a physical parameter by its free variable.
        """
        residual = self.problem.residual(self.centre)
        return float(residual @ residual), float(np.log(np.abs(self.problem.slope(self.centre))).sum())

    def __call__(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Log posterior density, relative to that at the centre, and its gradient at whitened coordinates `x`.

        The free variables are `self.centre` plus `self.factor` times `x`; `x` and the gradient are (n_params,). Minus
        infinity and a gradient of zeros where the model cannot be evaluated.
        """
        (least, log_slope), none, theta = self._at_centre, np.zeros(len(x)), self.centre + self.factor @ x
        try:
            with np.errstate(all="ignore"):
                linearization = self.problem.linearize(theta)
                value = 0.5 * (least - float(linearization.residual @ linearization.residual))
                gradient = -linearization.jacobian.T @ linearization.residual
                if self.flat_in == "physical":
                    value += float(np.log(np.abs(self.problem.slope(theta))).sum()) - log_slope
                    gradient = gradient + _log_slope_derivative(self.problem, theta)
        except (SingularModelError, np.linalg.LinAlgError):
            return -np.inf, none
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            return -np.inf, none
        return value, self.factor.T @ gradient


def _log_slope_derivative(problem: Problem, theta: FloatArray) -> FloatArray:
    """Derivative of log|dp/dtheta| by the own free variable of each parameter p, (n_params,), by central differences."""
    step = 1e-5
    ratio = problem.slope(theta + step) / problem.slope(theta - step)
    return np.log(np.abs(ratio)) / (2 * step)


def _covariance_root(estimate: Estimate, factor: FloatArray) -> FloatArray:
    """Symmetric root (n, n) of the covariance of the estimate in whitened coordinates x with theta = `factor` x.

    Whitened draws times this matrix have the covariance of the estimate. `factor` is (n, n).
    """
    slope = np.ones(len(estimate.names)) if estimate.parameters.slope is None else estimate.parameters.slope
    half = np.linalg.solve(factor, estimate.covariance / np.outer(slope, slope))
    values, vectors = np.linalg.eigh(np.linalg.solve(factor, half.T))
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T


def _by_nuts(
    target: _Target, n_draws: int, n_chains: int, n_warmup: int, rng: np.random.Generator, work: TaskExecutor
) -> _Drawn:
    """Posterior draws by the no-U-turn sampler: independent chains, run in parallel in pieces of `_AT_ONCE` draws.

    Each of the `n_chains` chains drops `n_warmup` draws and keeps `n_draws`. `target` is the log density; draws
    (n_chains, n_draws, n_params) are in its whitened coordinates, with the numbers of divergent trajectories and
    gradients of all chains. Each chain has a generator that `rng` spawns, and `work` runs it.
    """
    states: list[StoredValues] = [{"chain": None, "random": child.bit_generator.state} for child in rng.spawn(n_chains)]
    kept: list[list[FloatArray]] = [[] for _ in states]
    total = n_warmup + n_draws
    for first in range(0, max(total, 1), _AT_ONCE):
        name = f"chains to draw {min(first + _AT_ONCE, total)} of {total}"
        pieces = work.map(name, _chain_piece, (target, n_warmup, n_draws), states)
        for draws_of_chain, piece in zip(kept, pieces, strict=True):
            draws_of_chain.append(np.asarray(piece["draws"]))
        states = [{key: piece[key] for key in ("chain", "random")} for piece in pieces]
    chains = [restored(state["chain"]) for state in states]
    draws = np.array(
        [np.concatenate(draws_of_chain) @ chain.factor.T for draws_of_chain, chain in zip(kept, chains, strict=True)]
    )
    return _Drawn(
        draws, sum(int(chain.n_divergent) for chain in chains), sum(int(chain.n_gradients) for chain in chains)
    )


def _chain_piece(shared: tuple[_Target, int, int], item: StoredValues, tools: TaskContext) -> StoredValues:
    """Next 50 draws (`_AT_ONCE`, warm-up included) of one Markov chain and its stored state, as a parallel task.

    `shared` holds the target density, the length of the warm-up and the number of kept draws. `item` and the result
    have the keys ``chain`` (stored state, None before the first draw) and ``random`` (state of the generator); the
    result also has ``draws``, those that are kept, (n, n_params), in the coordinates of the chain. A first draw starts
    from a random point, halved until its density is positive. `tools` is not used.
    """
    target, n_warmup, n_draws = shared
    rng = _generator(item["random"])
    if item["chain"] is not None:
        state = restored(item["chain"])
    else:
        start = rng.standard_normal(len(target.factor))
        while not np.isfinite(target(start)[0]):
            start = 0.5 * start
        state = begun(target, start)
    state, draws = continued(target, state, n_warmup, n_draws, _AT_ONCE, rng)
    return {"chain": asdict(state), "random": rng.bit_generator.state, "draws": draws}


def _generator(state: StoredValues) -> np.random.Generator:
    """Random generator in the stored state `state` of its bit generator."""
    made = np.random.Generator(getattr(np.random, str(state["bit_generator"]))())
    made.bit_generator.state = state
    return made


def _by_emcee(target: _Target, n_draws: int, n_chains: int, n_warmup: int, rng: np.random.Generator) -> _Drawn:
    """Posterior draws by the ensemble sampler of emcee, (n_walkers, n_draws, n_params), each walker counted as a chain.

    There are max(`n_chains`, 2 n_params + 2) walkers, whose first max(`n_warmup`, `n_draws`) draws are dropped. Draws
    are in the whitened coordinates of `target`, the log density, with the number of its evaluations. Raises
    `InputError` if emcee is missing. `rng` gives the starts and a seed.
    """
    n_params = len(target.factor)
    try:
        import emcee
    except ImportError as error:
        raise InputError(f"`emcee` must be installed for this sampler, got {error}; {WITH_EXTRA}") from error
    n_walkers = max(n_chains, 2 * n_params + 2)
    moves = emcee.EnsembleSampler(n_walkers, n_params, lambda x: target(x)[0])
    seed = np.random.RandomState(int(rng.integers(2**31))).get_state()
    start = emcee.State(rng.standard_normal((n_walkers, n_params)), random_state=seed)
    burnt = max(n_warmup, n_draws)
    moves.run_mcmc(start, burnt + n_draws)
    return _Drawn(np.swapaxes(moves.get_chain(discard=burnt), 0, 1), 0, n_walkers * (burnt + n_draws + 1))


def split_r_hat(draws: FloatArray) -> float:
    """Rank-normalized split R-hat of one quantity, about 1 for chains that agree; NaN for constant or not finite draws.

    It is the larger of that of the draws and that of their absolute distances from the median of all chains; each chain
    is split into two halves.

    Parameters
    ----------
    draws : (n_chains, n_draws) float array

    References
    ----------
    Vehtari, Gelman, Simpson, Carpenter and Buerkner (2021), Bayesian Analysis 16, Eqs. (4), (14) and section 3.
    """
    if not np.isfinite(draws).all() or np.ptp(draws) == 0:
        return float("nan")
    folded = np.abs(draws - np.median(draws))
    return max(_r_hat(_rank_normal(_split(draws))), _r_hat(_rank_normal(_split(folded))))


def bulk_sample_size(draws: FloatArray) -> float:
    """Effective sample size of the rank-normalized draws (n_chains, n_draws), for means and medians; NaN if not finite."""
    return _sample_size(_rank_normal(_split(draws))) if np.isfinite(draws).all() else float("nan")


def tail_sample_size(draws: FloatArray) -> float:
    """Smaller effective sample size of the 5 % and the 95 % quantile of draws (n_chains, n_draws).

    NaN if a draw is not finite, or one of these parts does not vary, as where many draws equal the largest.
    """
    if not np.isfinite(draws).all():
        return float("nan")
    ends = np.quantile(draws, [0.05, 0.95])
    return float(np.min([_sample_size(_split((draws <= end).astype(np.float64))) for end in ends]))


def _split(draws: FloatArray) -> FloatArray:
    """Draws (n_chains, n_draws, ...) with each chain cut into two halves, (2 n_chains, n_draws // 2, ...).

    First halves come first; of an odd number the middle draw is left out.
    """
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, -half:]])


def _rank_normal(draws: FloatArray) -> FloatArray:
    """Normal quantiles of (rank - 3/8) / (S + 1/4) for all S `draws` together, in their shape; equal draws have their mean rank."""
    _, rank_of, counts = np.unique(draws, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - 0.5 * (counts - 1)
    return special.ndtri((ranks - 0.375) / (draws.size + 0.25))[rank_of].reshape(draws.shape)


def _r_hat(chains: FloatArray) -> float:
    """R-hat of `chains` (n_chains, n_draws): root of total over within-chain variance; NaN if they do not vary."""
    n = chains.shape[1]
    within = float(chains.var(axis=1, ddof=1).mean())
    between = float(chains.mean(axis=1).var(ddof=1))
    return float(np.sqrt((n - 1) / n + between / within)) if within > 0 else float("nan")


def _sample_size(chains: FloatArray) -> float:
    """Effective number of independent draws of `chains` (n_chains, n_draws), by Geyer's monotone autocorrelations.

    NaN if they do not vary.
    """
    m, n = chains.shape
    centred = chains - chains.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(centred, 2 * n, axis=1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=1)[:, :n].mean(axis=0) / n
    within = covariance[0] * n / (n - 1)
    total = covariance[0] + (float(chains.mean(axis=1).var(ddof=1)) if m > 1 else 0.0)
    if within <= 0 or total <= 0:
        return float("nan")
    rho = 1 - (within - covariance) / total
    rho[0] = 1.0
    pairs = rho[0 : n - n % 2 : 2] + rho[1:n:2]
    negative = np.flatnonzero(pairs <= 0)
    count = int(negative[0]) if negative.size else len(pairs)
    next_even = max(float(rho[2 * count]), 0.0) if 2 * count < n else 0.0
    time = -1 + 2 * float(np.minimum.accumulate(pairs[:count]).sum()) + next_even
    return m * n / max(time, 1 / np.log10(m * n))
