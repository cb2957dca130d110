"""`bayesid demo`: the paper's experiment."""

from __future__ import annotations

import argparse

from bayesid.cli.demo import run_demo
from bayesid.cli.options import end_with
from bayesid.cli.progress import StageBars
from bayesid.cli.terminal import show
from bayesid.posterior.sampler import Sampling
from bayesid.progress import Progress
from bayesid.results.folders import collect_incomplete


def run(options: argparse.Namespace) -> None:
    """A result folder, and what there is to say of it."""
    with StageBars(options.quiet) as bars:
        sampling = Sampling(budget=options.posterior_budget, seed=options.seed)
        with collect_incomplete() as incomplete:
            parts = run_demo(options.out, options.seed, sampling, Progress(bars.show))
    if not options.quiet:
        show(*parts)
    end_with(incomplete)
