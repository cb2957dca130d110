"""Min ESS a second of bayesid's moves and of emcee's stretch move on UR10e a_50s, and the time to convergence.

Usage: python bench.py [seconds for the stretch move]
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
import time
import warnings

import numpy as np

warnings.filterwarnings("ignore")

import bayesid

import emcee

from bayesid.log import read_log
from bayesid.moments import moments
from bayesid.noise import residual_noise
from bayesid.posterior.diagnostics import diagnose
from bayesid.posterior.evidence import log_evidence
from bayesid.posterior.likelihood import make_likelihood
from bayesid.posterior.prior import make_prior
from bayesid.posterior.sampler import SamplerOptions, sample
from bayesid.posterior.start import body_blocks, find_centre, spread_walkers
from bayesid.posterior.moves import Conditional
from bayesid.posterior.target import Target
from studies.real import DATA


def target_of(found: bayesid.Identification) -> Target:
    """The posterior of the best branch: settled signs fixed, the others summed out, noise of the filtered residual."""
    segments, signals = found.searched, found.signals
    raw = moments(found.model, found.coefficients, signals.motion, signals.effort, segments)
    signs = segments.per_sample(found.search.signs, *signals.effort.shape)
    predicted = found.model.effort(signals.motion, found.search.theta)
    used = signs != 0
    noise = residual_noise(np.where(used, signs * signals.effort - predicted, 0.0), used, signals.rate)
    settled = found.search.settled
    fixed = np.where(settled, found.search.signs, 0) if settled is not None else 0 * found.search.signs
    likelihood = make_likelihood(raw, found.coefficients, noise.sigma, noise.autocorrelation, fixed)
    return Target(make_prior(found.model.cone, likelihood), likelihood)


def line(name: str, diagnostics, wall: float, cpu: float, sweeps: int) -> None:
    """One line of the table."""
    ess = diagnostics.min_ess  # as many as there are walkers: none has moved
    print(
        f"{name:28s} wall {wall:6.1f} s cpu {cpu:6.1f} s steps {sweeps:6d} max R-hat {diagnostics.max_rhat:7.4f}"
        f" min ESS {ess:8.0f} = {ess / wall:7.1f}/s wall {ess / cpu:7.1f}/s cpu", flush=True,
    )  # fmt: skip


def stretch(target: Target, theta, seconds: float, kind: str) -> None:
    """The same diagnostics for a stock move, from the same starting points, its first half left out."""
    random = np.random.RandomState(0)
    centre = find_centre(target, theta, np.zeros(target.likelihood.n_joints))
    lines = Conditional(centre.covariance, body_blocks(target.prior.region))
    start = spread_walkers(target, centre, lines, 4 * 192, random).reshape(4, 192, -1)
    move = {"stretch": emcee.moves.StretchMove, "DE": emcee.moves.DEMove}[kind]()
    samplers = [
        emcee.EnsembleSampler(192, target.dimension, target.log_density, moves=move, vectorize=True) for _ in start
    ]
    began, cpu, states = time.perf_counter(), time.process_time(), [emcee.State(s) for s in start]
    steps = 0
    while time.perf_counter() - began < seconds:
        states = [s.run_mcmc(x, 500, thin_by=1, store=True, skip_initial_state_check=True) for s, x in zip(samplers, states)]
        steps += 500
    wall, cpu = time.perf_counter() - began, time.process_time() - cpu
    thin = max(1, steps // 800)
    chain = np.stack([s.get_chain(discard=steps // 2, thin=thin) for s in samplers], axis=1)
    theta, scale = target.split(chain)
    draws = np.concatenate([theta @ target.likelihood.projection.T, scale], axis=-1)
    accepted = np.mean([s.acceptance_fraction for s in samplers])
    line(f"emcee {kind} (accepts {accepted:.1%})", diagnose(draws), wall, cpu, steps)
    single = draws.reshape(len(draws), -1, 1, draws.shape[-1])
    print(f"{'':28s} between walkers: max R-hat {diagnose(single).max_rhat:.4f}; {single.shape[1]} walkers")


def main() -> None:
    """Everything."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 30.0
    began = time.perf_counter()
    found = bayesid.identify("ur10e", read_log(DATA / "ur10e" / "a_50s.csv").rectified())
    target = target_of(found)
    print(f"identify {time.perf_counter() - began:.1f} s; {target.dimension} dimensions,",
          f"{len(target.likelihood.unknown)} of {len(target.likelihood.fixed)} signs summed out,",
          "effective samples", np.round(target.likelihood.count).astype(int))
    for name, options in {
        "hit-and-run, to convergence": SamplerOptions(),
        "hit-and-run, 4 x 16 walkers": SamplerOptions(walkers=16),
        "hit-and-run, 4 x 128 walkers": SamplerOptions(walkers=128),
        "hit-and-run, 200 sweeps": SamplerOptions(first_look=200),
    }.items():
        began, cpu = time.perf_counter(), time.process_time()
        draws = sample(target, found.search.theta, options)
        line(name, draws.diagnostics, time.perf_counter() - began, time.process_time() - cpu, draws.sweeps)
        worst = draws.parameters
        single = draws.beta.reshape(draws.sweeps, -1, 1, draws.beta.shape[-1])
        print(f"{'':28s} between walkers: max R-hat {diagnose(single).max_rhat:.4f}; {single.shape[1]} walkers")
        print(f"{'':28s} link parameters: max R-hat {worst.max_rhat:.4f}, min ESS {worst.min_ess:.0f}")
    print(log_evidence(target, draws))
    stretch(target, found.search.theta, seconds, "stretch")
    stretch(target, found.search.theta, seconds, "DE")


if __name__ == "__main__":
    main()
