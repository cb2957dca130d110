"""Numbers of the posterior that are choices."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Sizes, shares and thresholds of sampling, of modes, and of what is kept of the draws.

    Many of them were halved and doubled (`python -m bayesid.studies.ablation posterior`). Where that was seen to
    change a decision on the demo and UR10e's log, the number's sentence says so.
    """

    # prior
    log_scale_sd: float = 0.5
    """Sd of the logarithm of a joint's noise over its reference: a factor of 1.6 (docs/posterior.md). Set by hand,
    wide beside what a log leaves, 1 / sqrt(2 n_j)."""
    least_noise: float = 1e-3
    """Noise that no effort is free of, as a share of its RMS."""
    link_reach: float = 0.25
    """Scale of a link's distances over the stretched arm: most of its length is two or three links. Halved or doubled,
    samples of the demo get other signs."""
    link_mass: float = 3.0
    """Scale of a link's mass over the mass that would make the log's efforts: the typical link has 0.3 of the scale."""

    # modes
    most_branches: int = 32
    """Assignments of the search's list, cheapest first, that are followed to their centres."""
    most_modes: int = 6
    """Modes that are sampled: each takes its share of the budget."""
    mode_depth: float = 10.0
    """Nats below the best mode's centre under which a mode does not matter: exp(-10) is 5e-5."""
    hopeless: float = 50.0
    """Nats by which a start's best fit may lie below the best one of all: five times `mode_depth`, as centres inside
    the region may differ less."""
    valley: float = 3.0
    """Nats that a valley between two modes is deep, at least: walkers cross one of exp(-3) = 5 % of the density."""
    valley_steps: int = 12
    """Into which the straight way between two modes is divided to look for the valley."""
    sign_rounds: int = 4
    """In which signs and parameters are made to agree; more change little."""
    negligible_mode: float = 1e-3
    """A mode of less weight leaves no draws: of the 4096 that posterior.nc keeps, four."""

    # start of the walkers
    hot: float = 4.0
    """Temperature at which walkers are spread: twice the posterior's sd, as R-hat wants it (Gelman and Rubin 1992)."""
    hot_sweeps: int = 3
    """Sweeps at that temperature."""
    reach: float = 0.9
    """Of the ellipsoid's radius, in which walkers begin: short of 1, for rounding."""

    # sampling
    fewest_sweeps: int = 8
    """Sweeps that are kept however little time remains: R-hat of split chains is defined from four on (ArviZ)."""
    early: float = 0.25
    """Share of all sweeps, the warm-up among them, that is left out at least: half of what Gelman and Rubin (1992)
    leave out of chains whose warm-up is no part of them, and R-hat still compares early with late."""
    growth: float = 1.5
    """The run grows by this factor between checks of its diagnostics: at most a third of it is more than was needed."""
    sweeps_at_once: int = 8
    """Sweeps after which the clock is looked at, and progress told."""
    idle: float = 0.05
    """Share of the walkers that may stay on a line: the last few take as many tries as all others."""
    most_tries: int = 200
    """A bracket that has shrunk this often is a point; the walker stays."""
    line_seconds: float = 2e-4
    """Nominal seconds of a line."""
    entry_seconds: float = 1.5e-9
    """Nominal seconds of an entry of the curvature, a walker."""
    product_seconds: float = 1.5e-9
    """Nominal seconds of a block's product with a coefficient, a walker."""
    diagnostics_work: float = 0.2
    """Work of the diagnostics, over that of the sweeps: 0.1 to 0.2 for arms of six and seven joints."""
    mass_sweeps: float = 40.0
    """Sweeps that take as long as a mode's mass: 30 to 70 for arms of six and seven joints."""

    # what draws say
    few_draws: int = 256
    """Draws that stand for all where each costs time: as many as walkers by default."""
    sign_draws: int = 1024
    """Draws from which probabilities of signs are averaged, to a Monte Carlo error below 0.5 / sqrt(1024) = 0.016."""
    kept_draws: int = 4096
    """Draws that are kept, in all; a round number: quantiles of 2.5 % then rest on a hundred draws, and the pointwise
    likelihood of a thousand blocks takes 16 MB."""
    of_prior: float = 0.1
    """Share of the prior's variance that the data leave at most where they decide a parameter: nine tenths of its
    precision are then theirs. A round number; docs/posterior.md, section 3, states it."""
    of_unconstrained: float = 0.5
    """Share of what prior and data leave of a variance that constraints leave at most where they decide: less than what
    the rest decides is theirs."""
    wider_warm_up: int = 12
    """Sweeps in which draws forget the narrower likelihood: as many as a run's warm-up."""
    wider_sweeps: int = 24
    """Sweeps that are kept of the wider one: as many as a run's first look wants."""
    from_zero: float = 1.02
    """Times the shortest interval that one from zero may be long: the place of the shortest is uncertain among
    draws."""
    near_edge: float = 0.9
    """Share of a window from which on a draw is near its edge: in its last tenth."""
    active_bounds: float = 0.2
    """Share of such draws from which on a window decides: a density that grows in proportion up to the edge has
    1 - 0.9^2 = 0.19 there. On the logs of study `real` it is 0.09 at most."""

    at_edge: float = 0.1
    """Standard deviations of its slack from a constraint's edge, within which a draw is at the edge: a share of draws
    over this is the density there, in units of the standard deviation."""
    presses: float = 0.02
    """Share of such draws from which on draws press against a constraint: a normal distribution that is cut one
    standard deviation from its mean, by which it loses a sixth of its mass, has 0.024."""

    # blocks
    block_length: float = 8.0
    """Autocorrelation times that a block lasts at least, so that neighbours say little of each other. On six real logs
    1 to 7 % of the blocks then have a Pareto k above 0.7, of segments 5 to 30 % (docs/posterior.md, section 7)."""
    most_blocks: int = 64
    """Blocks of a joint, but for those that are shorter because their segment is: each then holds a few hundredths of
    what a log says, whatever its length, and posterior.nc stays small."""
    agreed: float = 1e-3
    """Nats that a draw may leave to the other sign of a segment on which draws agree: what summing it out would add to
    the segment's likelihood, and ArviZ's summaries have two digits."""

    # mass of a mode
    mass_groups: int = 8
    """Groups of walkers whose spread gives the standard error of a mode's mass."""
    mass_walkers: int = 64
    """Walkers in each group."""
    mass_share: float = 0.3
    """Share of these walkers that stays at a level of the splitting."""
    level_sweeps: int = 3
    """Sweeps of hit-and-run at each level."""
    mass_steps: int = 3
    """Steps from the first normal distribution to the second."""
    step_sweeps: int = 8
    """Sweeps of hit-and-run at each step."""


TUNING = Tuning()
