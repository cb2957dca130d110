"""Constants of the posterior."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Sizes, shares and thresholds of sampling, modes and stored draws.

    "Ablation" means `python -m bayesid.studies.ablation posterior`: each value was halved and doubled on the demo and a
    UR10e log. A field mentions it only if a decision changed.
    """

    # prior
    log_scale_sd: float = 0.5
    """Prior sd of the logarithm of a joint's noise over its reference: a factor of 1.6 (docs/posterior.md). Chosen; it
    matters little, as a log determines this logarithm to 1 / sqrt(2 n_j)."""
    least_noise: float = 1e-3
    """Least noise of an effort, over its RMS."""
    link_reach: float = 0.25
    """Scale of a link's distances over the stretched arm, which is mostly two or three links. Ablation: signs of the
    demo change."""
    link_mass: float = 3.0
    """Scale of a link's mass over the mass that explains the log's efforts; the typical link has 0.3 of the scale."""

    # modes
    most_branches: int = 32
    """Listed assignments, cheapest first, from which modes are searched."""
    most_modes: int = 6
    """Largest number of sampled modes; each takes its share of the budget."""
    mode_depth: float = 10.0
    """Nats below the best mode's centre under which a mode is dropped: exp(-10) is 5e-5."""
    start_depth: float = 50.0
    """Nats below the best start's fit under which a start is dropped: five times `mode_depth`, as the densities at
    centres inside the region may differ less than those of the fits."""
    valley: float = 3.0
    """Least depth of a valley between two modes, nats; walkers cross one of exp(-3) = 5 % of the density."""
    valley_steps: int = 12
    """Points on the straight line between two modes where the density is evaluated."""
    sign_rounds: int = 4
    """Alternations of signs and parameters at a start; more change little."""
    negligible_mode: float = 1e-3
    """Least weight of a mode with stored draws: four of the 4096 in posterior.nc."""

    # start of the walkers
    hot: float = 4.0
    """Temperature at which walkers start: twice the posterior's sd, as R-hat needs (Gelman and Rubin 1992)."""
    hot_sweeps: int = 3
    """Sweeps at that temperature."""
    reach: float = 0.9
    """Share of the ellipsoid's radius in which walkers start; below 1 because of rounding."""

    # sampling
    fewest_sweeps: int = 8
    """Least number of kept sweeps, whatever the budget; R-hat of split chains needs four (ArviZ)."""
    early: float = 0.25
    """Least share of all sweeps, warm-up included, that is dropped: half of that of Gelman and Rubin (1992), whose
    chains have no separate warm-up. R-hat still compares early with late sweeps."""
    growth: float = 1.5
    """Factor on the number of sweeps between checks of the diagnostics; at most a third of a run is not needed."""
    sweeps_at_once: int = 8
    """Sweeps between checks of the clock and reports of progress."""
    idle: float = 0.05
    """Share of the walkers that may stay where they are on a line; the last ones need as many tries as all others."""
    most_tries: int = 200
    """Tries after which a bracket counts as a point and the walker stays where it is."""
    line_seconds: float = 2e-4
    """Nominal seconds of a line."""
    entry_seconds: float = 1.5e-9
    """Nominal seconds of an entry of the curvature, for each walker."""
    product_seconds: float = 1.5e-9
    """Nominal seconds of the product of a block with a coefficient, for each walker."""
    diagnostics_work: float = 0.2
    """Work of the diagnostics over that of the sweeps: 0.1 to 0.2 for arms of six and seven joints."""
    mass_sweeps: float = 40.0
    """Work of a mode's mass, in sweeps: 30 to 70 for arms of six and seven joints."""

    # use of the draws
    few_draws: int = 256
    """Draws for expensive computations: as many as walkers by default."""
    sign_draws: int = 1024
    """Draws for probabilities of signs; Monte Carlo error below 0.5 / sqrt(1024) = 0.016."""
    kept_draws: int = 4096
    """Stored draws: about a hundred below a quantile of 2.5 %; the pointwise likelihood of 1000 blocks takes 16 MB."""
    of_prior: float = 0.1
    """Largest posterior over prior variance of a parameter that the data decide: 90 % of its precision is theirs. A
    convention, stated in docs/posterior.md, section 3."""
    of_unconstrained: float = 0.5
    """Largest ratio of a variance with and without constraints for which the constraints decide."""
    wider_warm_up: int = 12
    """Sweeps in which draws forget the narrower likelihood; equal to the warm-up."""
    wider_sweeps: int = 24
    """Kept sweeps of the wider likelihood; equal to those before the first check."""
    from_zero: float = 1.02
    """Largest length of an interval from zero, over that of the shortest interval, with which it is preferred; the
    Monte Carlo error of the lengths is of this size."""
    near_edge: float = 0.9
    """Share of a window's range above which a draw is near its edge: the last tenth."""
    active_bounds: float = 0.2
    """Share of such draws above which a window is active. A density proportional to the share has 1 - 0.9^2 = 0.19; on
    the logs of study `real` it is at most 0.09."""

    at_edge: float = 0.1
    """Distance from a constraint's edge, in sd of its slack, of a draw at the edge. The share of draws over it is the
    density at the edge, in units of 1 / sd."""
    active_constraint: float = 0.02
    """Share of draws at the edge above which a constraint is active. A normal distribution cut one sd from its mean,
    which removes a sixth of its mass, has 0.024."""

    # blocks
    block_length: float = 8.0
    """Least length of a block in autocorrelation times, so that blocks are nearly independent. On six real logs 1 to 7
    % of the blocks then have a Pareto k above 0.7, of segments 5 to 30 % (docs/posterior.md, section 7)."""
    most_blocks: int = 64
    """Largest number of blocks of a joint, short segments apart. Each block then has a few per cent of the log's
    information, and posterior.nc stays small."""
    agreed: float = 1e-3
    """Largest contribution of the other sign to a segment's log-likelihood, nats, for a draw to determine the sign;
    ArviZ's summaries have two digits."""

    # mass of a mode
    mass_groups: int = 8
    """Groups of walkers whose spread is the standard error of a mode's mass."""
    mass_walkers: int = 64
    """Walkers in each group."""
    mass_share: float = 0.3
    """Share of these walkers that remains at each level of the splitting."""
    level_sweeps: int = 3
    """Sweeps of hit-and-run at each level."""
    mass_steps: int = 3
    """Intermediate distributions between the first and the second normal one."""
    step_sweeps: int = 8
    """Sweeps of hit-and-run at each step."""


TUNING = Tuning()
