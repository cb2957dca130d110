"""Simulation-based calibration of the posterior sampler (Talts, Betancourt, Simpson, Vehtari and Gelman 2018).

Every trial draws parameters and noise scales from a stated prior, simulates data from them, samples the posterior and
takes the rank of each true value among L draws. If prior, likelihood and sampler are correct, each rank is uniform on
0 ... L, for any prior and model.

- Truth: an arm of two joints with all default terms, 28 parameters and 14 coefficients. Its prior is that of
  `make_prior` for a reference arm, the same in all trials. Exact draws by rejection, on eigenvalues, without the code
  under test.
- Data: each segment is multiplied by a random sign, + and - equally likely for any effort, so the likelihood's mixture
  is exact. Joint 2 is measured every other sample and held, with its noise: its autocorrelation time is exactly 2. The
  noise is about as large as the efforts, so that cone, prior and signs matter; the reference noise is fixed.
- Signs: with all signs unknown the posterior has many modes, which no short chain connects. Leaving out such trials
  would bias the ranks. So the signs of 70 % of the segments, chosen before there are data, are given; one mode remains.
  The other signs are summed out; in a typical trial a third of them stays ambiguous. The study therefore tests sampling
  within a mode, not the search for modes and their weights.
- Draws: one per walker, L = 127 of 128, at a random kept sweep. Walkers are independent, so these draws are too,
  without thinning. They include draws right after the warm-up, so a warm-up that is too short shows. All walkers start
  from the prior's inner point, without data.
- Tests: with U uniform on [0, 1], x = (rank + U) / (L + 1) is exactly uniform, and so is |2 x - 1|. Exact tests of
  Kolmogorov and Smirnov detect a bias of the draws with the first, and a wrong width with the second. The smallest p of
  all quantities and both tests is corrected after Bonferroni, valid under any dependence. Trials that did not converge
  are counted, and included in the ranks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from bayesid.arrays import Array, Integers, Mask
from bayesid.effects import STANDARD
from bayesid.effects.catalogue import make_terms
from bayesid.effects.coefficients import BaseCoefficients, base_coefficients
from bayesid.effects.model import Model
from bayesid.log.segments import Segments
from bayesid.motion import Motion
from bayesid.posterior.likelihood import make_likelihood
from bayesid.posterior.sampler import Draws, Sampling, sample
from bayesid.posterior.target import Target, TruncatedGaussian, make_prior
from bayesid.regression.knowledge import LinkPrior
from bayesid.regression.normal_equations import normal_equations
from bayesid.robot.inertia import pseudo_inertia
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import random_trajectory
from bayesid.studies.record import Row
from bayesid.studies.simulated import two_joint_arm
from bayesid.studies.study import Study, in_turn

if TYPE_CHECKING:
    from bayesid.studies.figures import Figure

LINKS = LinkPrior()
"""Prior of a link: the default."""
SIGMA = np.array([10.0, 30.0])
"""N m, the reference noise."""
AUTOCORRELATION = np.array([1.0, 2.0])
"""Autocorrelation times in samples: joint 2 is held for two."""
LAST = 127
"""L, the largest rank."""
FLAWS = ("", "noise", "prior", "tempering")
"""Mistakes that calibration should detect: half the reference noise, the prior's mean wrong by one sd, autocorrelation
ignored."""
_STREAM = 0
"""Stream of random numbers, different from that of other studies."""
_SAMPLES = 240
"""Of the log: few, so that a trial takes seconds and signs stay ambiguous."""
_RATE = 60.0
"""Hz."""
_SEGMENT = 4
"""Samples of a segment."""
_SUMMED, _PERIOD = 3, 10
"""Three of ten consecutive segments have their signs summed out: with more, trials have several modes."""
_SAMPLING = Sampling(ensembles=4, walkers=(LAST + 1) // 4, budget=600.0)
_DOUBT = 0.01
"""A sign is ambiguous if both signs are likelier than this."""
_PROPOSALS = 20_000
"""Of a body at a time: about as many as one physical draw needs."""
_MOST_BINS = 16
"""Of ranks; a power of two, as L + 1 is."""
_FEWEST_IN_BIN = 5
"""Trials expected in a bin, from which the test by chi-square holds (Cochran 1954)."""


# ---------------------------------------------------------------------------------------------------------------
# What all trials share
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Setting:
    """The model, its prior and the motion, the same in all trials.

    Attributes:
        model: an arm of two joints.
        coefficients: its base coefficients.
        motion: N samples, each repeated once.
        segments: S segments, all of the same length.
        summed: (S,) whether a segment's sign is summed out.
        prior: of the parameters.
    """

    model: Model
    coefficients: BaseCoefficients
    motion: Motion
    segments: Segments
    summed: Mask
    prior: TruncatedGaussian


@cache
def setting() -> Setting:
    """The setting, made once per process."""
    robot = two_joint_arm()
    instants = np.repeat(np.arange(0, _SAMPLES, 2), 2) / _RATE
    motion = random_trajectory(2, _SAMPLES / _RATE, rng=4, harmonics=3).motion(instants)
    model = Model(robot, make_terms(STANDARD, robot, motion))
    coefficients = base_coefficients(model)
    start = np.tile(np.arange(0, _SAMPLES, _SEGMENT), 2)
    size = len(start)
    joint, known = np.repeat([0, 1], size // 2), np.zeros(size, dtype=np.int64)
    segments = Segments(joint, start, start + _SEGMENT, known, np.ones(size, dtype=bool))
    usual = model.effort(motion, random_parameters(model, rng=np.random.default_rng(0)))
    reference = make_likelihood(
        normal_equations(model, coefficients, motion, usual, segments), coefficients, SIGMA, AUTOCORRELATION, known
    )
    summed = np.arange(size) % _PERIOD < _SUMMED
    return Setting(model, coefficients, motion, segments, summed, make_prior(model.cone, reference, LINKS))


def draw_prior(rng: np.random.Generator) -> tuple[Array, Array]:
    """Parameters (P,) and logarithms of the noise scales (n,) from the prior, by rejection."""
    prior, cone = setting().prior, setting().model.cone
    log_scale = prior.log_scale_sd * rng.standard_normal(len(prior.log_scale_sd))
    while True:
        theta = prior.mean + prior.sd * rng.standard_normal(cone.size)
        theta[cone.nonnegative] = np.abs(theta[cone.nonnegative])  # their means are zero
        for body in cone.bodies:
            theta[body] = _draw_body(prior.mean[body], prior.sd[body], rng)
        if LINKS.total_mass[0] < theta[cone.bodies[:, 9]].sum() < LINKS.total_mass[1]:
            return theta, log_scale


def _draw_body(mean: Array, sd: Array, rng: np.random.Generator) -> Array:
    """(10,) parameters of a body; about one of 25 000 proposals is physical."""
    while True:
        proposed = mean + sd * rng.standard_normal((_PROPOSALS, 10))
        diagonal, mass = proposed[:, [0, 3, 5]], proposed[:, 9]
        trace = diagonal.sum(axis=1) / 2
        proposed = proposed[(diagonal.max(axis=1) < trace) & (mass > 0.0) & (trace < LINKS.largest_radius**2 * mass)]
        physical = proposed[np.linalg.eigvalsh(pseudo_inertia(proposed))[:, 0] > 0.0]
        if len(physical):
            return physical[0]


# ---------------------------------------------------------------------------------------------------------------
# One trial
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Scenario:
    """A possible mistake.

    Attributes:
        flaw: one of FLAWS, which the sampled posterior has and the data do not.
    """

    flaw: str = ""


def trial(scenario: Scenario, seed: int) -> Row:
    """The ranks of one trial."""
    rng = np.random.default_rng([_STREAM, seed])
    truth, log_scale = draw_prior(rng)
    effort, signs = simulated(truth, log_scale, rng)
    target = target_of(effort, signs, scenario.flaw)
    unknown = target.likelihood.unknown
    draws = sample(target, target.prior.inside, replace(_SAMPLING, rng=int(rng.integers(2**31))))
    theta, scale = _independent(draws, rng)
    plus = target.likelihood.plus_probability(theta, scale)[:, unknown]
    among = _quantities(target, theta, scale, np.where(rng.random(plus.shape) < plus, 1.0, -1.0))
    true = _quantities(target, truth[None], log_scale[None], signs[None, unknown].astype(float))
    chance = plus.mean(axis=0)
    return {
        "ranks": {name: int(np.sum(among[name] < true[name])) for name in true},
        "doubtful": float(np.mean((chance > _DOUBT) & (chance < 1.0 - _DOUBT))),
        "converged": bool(draws.converged),
        "max_rhat": draws.diagnostics.max_rhat,
        "min_ess": draws.diagnostics.min_ess,
        "sweeps": draws.sweeps,
    }


def simulated(theta: Array, log_scale: Array, rng: np.random.Generator) -> tuple[Array, Integers]:
    """Efforts (N, n), every segment multiplied by its sign, and the signs (S,)."""
    given = setting()
    signs = rng.choice([-1, 1], len(given.segments))
    noise = rng.standard_normal((len(given.motion), len(SIGMA)))
    noise[1::2, 1] = noise[::2, 1]
    effort = given.model.effort(given.motion, theta) + np.exp(log_scale) * SIGMA * noise
    return given.segments.per_sample(signs, *effort.shape) * effort, signs


def target_of(effort: Array, signs: Integers, flaw: str) -> Target:
    """The posterior of efforts (N, n), given the signs (S,) of the segments that are not summed out."""
    given, prior = setting(), setting().prior
    sigma = 0.5 * SIGMA if flaw == "noise" else SIGMA
    autocorrelation = np.ones_like(AUTOCORRELATION) if flaw == "tempering" else AUTOCORRELATION
    if flaw == "prior":
        prior = replace(prior, mean=prior.mean + prior.sd)
    fixed = np.where(given.summed, 0, signs)
    known = np.where(given.segments.joint == 0, fixed, 0)  # uses both ways to give a sign
    segments = replace(given.segments, known=known)
    moment = normal_equations(given.model, given.coefficients, given.motion, effort, segments, most_individual=5)
    return Target(prior, make_likelihood(moment, given.coefficients, sigma, autocorrelation, fixed - known))


def _independent(draws: Draws, rng: np.random.Generator) -> tuple[Array, Array]:
    """L independent draws: parameters (L, P) and logarithms of the noise scales (L, n)."""
    shape = draws.log_density.shape
    at = (rng.integers(shape[0], size=shape[1:]), *np.indices(shape[1:]))
    theta, log_scale = draws.theta[at], draws.log_scale[at]
    return theta.reshape(LAST + 1, -1)[:LAST], log_scale.reshape(LAST + 1, -1)[:LAST]


def _quantities(target: Target, theta: Array, log_scale: Array, signs: Array) -> dict[str, Array]:
    """(W,) values of all ranked quantities.

    Coefficients (friction and offsets are coefficients themselves); rotor inertias and masses, which the data determine
    in part; noise scales; agreement of signs and efforts; log likelihood and log density, which reveal mistakes that no
    single parameter reveals (Modrak et al. 2023).

    Args:
        target: the posterior.
        theta: (W, P) parameters.
        log_scale: (W, n) logarithms of the noise scales.
        signs: (W, w) of the segments that are summed out.
    """
    given, likelihood = setting(), target.likelihood
    values = dict(zip(given.coefficients.names, given.coefficients.project(theta).T, strict=True))
    bodies = given.model.cone.bodies
    actuators = np.setdiff1d(np.arange(theta.shape[1]), bodies)
    for k in np.setdiff1d(np.append(actuators, bodies[:, 9]), given.coefficients.selected):
        values[given.model.parameters[k].name] = theta[:, k]
    for j, column in enumerate(log_scale.T, start=1):
        values[f"log noise {j}"] = column
    values["signs agree"] = np.sum(signs * likelihood.push(theta, log_scale)[:, likelihood.unknown], axis=1)
    values["log likelihood"] = likelihood.log_likelihood(theta, log_scale)
    values["log density"] = target.log_density(np.concatenate([theta, log_scale], axis=1))
    return values


# ---------------------------------------------------------------------------------------------------------------
# All trials
# ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Calibration:
    """Tests whether the ranks of K quantities in T trials are uniform.

    Attributes:
        names: (K,) the quantities.
        ranks: (T, K) 0 ... L.
        extra: (T, K) uniform variables on [0, 1].
    """

    names: tuple[str, ...]
    ranks: Integers
    extra: Array

    @classmethod
    def of(cls, rows: Sequence[Row]) -> Calibration:
        """From the rows of a study."""
        ranks = np.array([list(row["ranks"].values()) for row in rows])
        extra = np.random.default_rng(0).random(ranks.shape)
        return cls(tuple(rows[0]["ranks"]), ranks, extra)

    @property
    def bins(self) -> int:
        """Bins of equal size for the chi-square test, with at least five expected trials each."""
        bins = _MOST_BINS
        while bins > 2 and len(self.ranks) < _FEWEST_IN_BIN * bins:
            bins //= 2
        return bins

    @property
    def chi_square(self) -> Array:
        """(K,) p of the ranks' counts in bins."""
        binned = self.ranks * self.bins // (LAST + 1)
        return np.array([stats.chisquare(np.bincount(column, minlength=self.bins)).pvalue for column in binned.T])

    @cached_property
    def shift(self) -> Array:
        """(K,) p of x = (rank + U) / (L + 1) against the uniform distribution: biased draws."""
        return _uniform(self._fraction)

    @cached_property
    def spread(self) -> Array:
        """(K,) p of |2 x - 1|: draws too narrow or too wide."""
        return _uniform(np.abs(2.0 * self._fraction - 1.0))

    @property
    def _fraction(self) -> Array:
        return (self.ranks + self.extra) / (LAST + 1)

    @property
    def p(self) -> float:
        """Of all quantities together: for a correct sampler it is below a level with at most that probability."""
        return float(min(1.0, 2.0 * len(self.names) * min(self.shift.min(), self.spread.min())))


def _uniform(values: Array) -> Array:
    """(K,) exact p of columns (T, K) on [0, 1]."""
    return np.array([stats.kstest(column, "uniform", method="exact").pvalue for column in values.T])


def report(rows: Sequence[Row]) -> str:
    """Ranks of all quantities, and tests of their uniformity."""
    calibration = Calibration.of(rows)
    trials, doubtful = len(rows), np.array([row["doubtful"] for row in rows])
    slow = [row["trial"] for row in rows if not row["converged"]]
    return "\n".join(
        [
            *_table(calibration),
            "",
            f"standard error of a mean rank: {(LAST + 1) / np.sqrt(12.0 * trials):.1f}",
            *_summary(calibration),
            f"not converged: {len(slow)} of {trials} trials{f', {slow}' if slow else ''} (included)",
            f"worst R-hat {max(row['max_rhat'] for row in rows):.4f}, least ESS {min(r['min_ess'] for r in rows):.0f}",
            f"ambiguous signs among those summed out (1 % < P(+) < 99 %): {100 * doubtful.mean():.0f} %, "
            f"per trial {100 * doubtful.min():.0f} to {100 * doubtful.max():.0f} %",
            f"seconds per trial, median: {np.median([row['timings']['seconds'] for row in rows]):.2f}",
            f"all quantities, shift and spread, after Bonferroni: p = {calibration.p:.2g}",
        ]
    )


def _table(calibration: Calibration) -> list[str]:
    """One line per quantity."""
    note = f"({LAST / 2} expected; {calibration.bins} bins)"
    lines = [f"{'quantity':<16}  mean rank  chi2 p  KS p shift  KS p spread    {note}"]
    means, tests = calibration.ranks.mean(axis=0), (calibration.chi_square, calibration.shift, calibration.spread)
    for name, mean, chi_square, shift, spread in zip(calibration.names, means, *tests, strict=True):
        lines.append(f"{name:<16}  {mean:9.1f}  {chi_square:6.4f}  {shift:10.4f}  {spread:11.4f}")
    return lines


def _summary(calibration: Calibration) -> list[str]:
    """One line per test, over all quantities."""
    lines = []
    for name in ("chi_square", "shift", "spread"):
        values, label = getattr(calibration, name), name.replace("_", "-") + ":"
        below, together = int(np.sum(values < 0.05)), stats.kstest(values, "uniform").pvalue
        lines.append(
            f"{label:<12} {below:2d} of {len(values)} p below 5 %, smallest {values.min():.2g}, after Bonferroni "
            f"{min(1.0, len(values) * values.min()):.2g}; uniformity of p if independent: {together:.2g}"
        )
    return lines


def draw(rows: Sequence[Row], figure: Figure) -> None:
    """Distribution of the ranks of each quantity minus the uniform one, with pointwise 95 % band."""
    from bayesid.studies.figures import COLOURS

    count, ax = len(rows), figure.subplots()
    x = np.arange(LAST + 2) / (LAST + 1)
    for column in Calibration.of(rows).ranks.T:
        share = np.searchsorted(np.sort(column), np.arange(LAST + 2), side="left") / count
        ax.plot(x, share - x, color=COLOURS[0], lw=0.8, alpha=0.7)
    band = 1.96 * np.sqrt(x * (1.0 - x) / count)
    ax.fill_between(x, -band, band, color="#bbbbbb", alpha=0.4, lw=0.0, label="pointwise 95 % band")
    ax.set_xlabel("rank of the truth among the draws, 0 to 1")
    ax.set_ylabel("share of trials below, minus expected")
    ax.legend(fontsize=8)


STUDY = Study("sbc", 200, in_turn([Scenario()]), trial, report, draw)
FLAWED = {flaw: replace(STUDY, plan=in_turn([Scenario(flaw)])) for flaw in FLAWS if flaw}
"""Studies with a mistake in the posterior, by its name."""
