"""What the options of several commands stand for: logs, terms, a search, a sampling."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayesid.cli.terminal import warn
from bayesid.errors import InputError
from bayesid.fit.knowledge import Beliefs, read_nominal
from bayesid.log.log import Log, read_log
from bayesid.model.terms import RigidBody
from bayesid.posterior.sampler import Sampling


def reading_options(options: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `bayesid.read_log`."""
    joints = None if options.joints is None else [name.strip() for name in options.joints.split(",")]
    direct = {name: getattr(options, name) for name in ("unsigned", "degrees", "topic")}
    return {"gains": _gains(options.gains), "joints": joints, **direct}


def read(path: Path, reading: Mapping[str, Any]) -> Log:
    """A log; each warning of its reader is one line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        log = read_log(path, **reading)
    for warning in caught:
        warn(str(warning.message))
    return log


def term_names(options: argparse.Namespace) -> list[str]:
    """Names of the model's terms."""
    terms = [name.strip() for name in options.terms.split(",")]
    if RigidBody.name not in terms:
        raise InputError(f"{RigidBody.name} is missing", "--terms", "add it: a robot has links")
    return terms


def beliefs(options: argparse.Namespace) -> Beliefs:
    """What is believed before the log."""
    return Beliefs(nominal={} if options.nominal is None else read_nominal(options.nominal))


def sampling(options: argparse.Namespace) -> Sampling | bool:
    """How the posterior is sampled, or that it is not; bad options are refused either way."""
    chosen = Sampling(budget=options.posterior_budget, seed=options.seed, repeatable=options.repeatable)
    return False if options.no_posterior else chosen


def _gains(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"{text!r} is not a list of numbers", "--gains", "give K1,K2,.. in N m/A") from None
