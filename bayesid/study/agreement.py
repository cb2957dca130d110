"""Whether separate runs of one robot agree within their standard deviations.

Estimates of a coefficient from K independent logs scatter by their standard deviations, if these are right and the
robot did not change. The weighted mean and chi-square (Birge 1932; Cochran's Q) test this for each coefficient. More
scatter means errors that a single log does not show: missing effects, gains, temperature, another payload.

A common prior pulls all runs to the same value, so coefficients that it dominates scatter less. Coefficients of one run
are correlated: several may differ, or agree, together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import bdtrc, chdtrc, chdtri

from bayesid.arrays import Array, Integers, Mask
from bayesid.errors import InputError
from bayesid.report.tuning import TUNING
from bayesid.report.words import table

Row = Mapping[str, Any]
"""A coefficient of one run, as in coefficients.csv: `name`, `expression`, `unit`, `mean`, `sd`; others are ignored."""


@dataclass(frozen=True)
class Agreement:
    """C coefficients of K separate runs; NaN for undefined numbers."""

    n_runs: int  #: K
    names: tuple[str, ...]  #: (C,) of the coefficients
    #: (C,) in the standard parameters; the same name with another expression is another coefficient
    expressions: tuple[str, ...]
    units: tuple[str, ...]  #: (C,)
    shared: Mask  #: (C,) whether every run's model has it
    runs: Integers  #: (C,) k, number of runs that determine it: their standard deviation is finite
    mean: Array  #: (C,) over these runs, weighted with 1 / sd^2, in the coefficient's unit
    sd: Array  #: (C,) of that mean, if the runs' standard deviations are right: (sum of 1 / sd^2)^-1/2; inf if k = 0
    spread: Array  #: (C,) sample standard deviation of the runs' means (divided by k - 1); needs k >= 2, as all below
    typical_sd: Array  #: (C,) root mean square of the runs' standard deviations
    chi_square: Array  #: (C,) Cochran's Q, the sum of (mean of a run - weighted mean)^2 / sd^2
    dof: Integers  #: (C,) its degrees of freedom, k - 1, and 0 if k = 0
    p: Array  #: (C,) probability that chance alone gives so large a chi-square, the standard deviations being right

    def __len__(self) -> int:
        return len(self.names)

    @property
    def compared(self) -> Mask:
        """(C,) whether two runs or more determine it."""
        return self.dof > 0

    @property
    def ratio(self) -> Array:
        """(C,) spread over typical standard deviation: its square is 1 on average if these are right.

        With equal standard deviations it is the Birge ratio, the root of chi-square over its degrees of freedom (R. T.
        Birge, "The calculation of errors by the method of least squares", Phys. Rev. 40, 207, 1932).
        """
        return self.spread / self.typical_sd

    @property
    def factor(self) -> float:
        """Factor on all standard deviations at which the typical coefficient would agree.

        The median, over the coefficients compared, of the root of chi-square over the median of its distribution: a
        Birge ratio whose median is 1 for any number of runs. NaN if no coefficient is compared.
        """
        chi_square, dof = self.chi_square[self.compared], self.dof[self.compared]
        return float(np.median(np.sqrt(chi_square / chdtri(dof, 0.5)))) if len(dof) else np.nan

    @property
    def differing(self) -> Mask:
        """(C,) whether the runs differ at 1 %."""
        differing: Mask = self.p < TUNING.level  # NaN is not
        return differing

    @property
    def beyond_chance(self) -> bool:
        """Whether such differences have a probability below about 0.001 if standard deviations are right.

        Either many coefficients differ, or one differs by much (Bonferroni's bound). The first test assumes independent
        coefficients; with the correlations of a UR10e's posterior its level is 0.003 to 0.005.
        """
        number, count = int(self.compared.sum()), int(self.differing.sum())
        many = number > 0 and bdtrc(count - 1, number, TUNING.level) < TUNING.chance
        return bool(many or np.any(self.p < TUNING.chance / max(number, 1)))

    @property
    def sentence(self) -> str:
        """The result as one sentence."""
        number, k, absent = int(self.compared.sum()), self.n_runs, int((~self.shared).sum())
        missing = (
            f"; {absent} coefficient{' is' if absent == 1 else 's are'} not in every run's model" if absent else ""
        )
        if not number:
            return f"the {k} runs cannot be compared: no coefficient is identifiable in two of them{missing}"
        times = f"{self.factor:.1f} times that expected from their standard deviations"
        of = f"(median of {number} coefficient{'s' * (number > 1)}, {k} runs)"
        differing = f"{int(self.differing.sum())} of {number} differ at 1 %"
        count = f"{differing}, {TUNING.level * number:.2g} expected by chance{missing}"
        if self.factor > TUNING.alike:
            chance = "" if self.beyond_chance else ", which may be chance"
            return f"scatter between runs is {times} {of}{chance}: {count}"
        if self.beyond_chance:
            return f"some coefficients differ significantly, but scatter between runs is {times} {of}: {count}"
        words = "as expected" if self.factor >= 1.0 / TUNING.alike else "better than expected"
        return f"the runs agree {words}: scatter between runs is {times} {of}; {count}"


def agreement(runs: Sequence[Sequence[Row]]) -> Agreement:
    """Compares the coefficients of separate runs.

    A run that lacks a coefficient, or does not determine it (infinite standard deviation), is left out for it.

    Args:
        runs: two or more, the rows of each run's coefficients.csv, with numbers or text.

    Raises:
        InputError: there are fewer than two runs, or a run holds a coefficient twice.
        KeyError: a row lacks a column.
    """
    if len(runs) < 2:
        raise InputError(f"needs two runs or more, not {len(runs)}", "agreement", "give more logs")
    tables = [_by_coefficient(run) for run in runs]
    keys = list(dict.fromkeys(key for table in tables for key in table))
    absent = (np.nan, np.inf)
    values = np.array([[table.get(key, absent) for key in keys] for table in tables]).reshape(len(tables), len(keys), 2)
    mean, sd = values[:, :, 0], values[:, :, 1]
    decided = np.isfinite(mean) & np.isfinite(sd) & (sd > 0.0)
    return Agreement(
        n_runs=len(runs),
        names=tuple(key[0] for key in keys),
        expressions=tuple(key[1] for key in keys),
        units=tuple(key[2] for key in keys),
        shared=np.array([all(key in table for table in tables) for key in keys], dtype=bool),
        **_statistics(np.where(decided, mean, 0.0), np.where(decided, sd, np.inf), decided),
    )


def _by_coefficient(run: Sequence[Row]) -> dict[tuple[str, str, str], tuple[float, float]]:
    table = {(row["name"], row["expression"], row["unit"]): (float(row["mean"]), float(row["sd"])) for row in run}
    if len(table) < len(run):
        raise InputError("a run holds a coefficient twice", "agreement", "give each run's coefficients once")
    return table


def _statistics(mean: Array, sd: Array, decided: Mask) -> dict[str, Any]:
    """Numerical fields of an `Agreement`, from (K, C) means, sds and which runs determine a coefficient.

    The sd is infinite, and the weight 0, if a run does not determine a coefficient. Cochran's Q as in W. G. Cochran,
    "The combination of estimates from different experiments", Biometrics 10, 101, 1954.
    """
    k = decided.sum(axis=0)
    several = k >= 2
    weight = 1.0 / sd**2
    with np.errstate(divide="ignore", invalid="ignore"):  # NaN for coefficients that fewer than two runs determine
        pooled = (weight * mean).sum(axis=0) / weight.sum(axis=0)
        of_mean = 1.0 / np.sqrt(weight.sum(axis=0))
        centre = mean.sum(axis=0) / k
        spread = np.sqrt((np.where(decided, mean - centre, 0.0) ** 2).sum(axis=0) / (k - 1))
        typical = np.sqrt((np.where(decided, sd, 0.0) ** 2).sum(axis=0) / k)
        chi_square = (weight * np.where(decided, mean - pooled, 0.0) ** 2).sum(axis=0)
    return {
        "runs": k,
        "mean": pooled,
        "sd": of_mean,
        "spread": np.where(several, spread, np.nan),
        "typical_sd": np.where(several, typical, np.nan),
        "chi_square": np.where(several, chi_square, np.nan),
        "dof": np.maximum(k - 1, 0),
        "p": np.where(several, chdtrc(np.maximum(k - 1, 1), chi_square), np.nan),
    }


# ---- Output ----
_COLUMNS = ("runs", "mean", "sd", "spread", "typical_sd", "ratio", "chi_square", "dof", "p")


def rows(agreement: Agreement) -> list[dict[str, object]]:
    """agreement.csv: one row per coefficient, in the order of the runs; empty for undefined numbers."""
    values = {name: getattr(agreement, name).tolist() for name in _COLUMNS}
    labels = zip(agreement.names, agreement.expressions, agreement.units, strict=True)
    return [
        {"name": name, "expression": expression, "unit": unit}
        | {column: "" if values[column][c] != values[column][c] else values[column][c] for column in _COLUMNS}
        for c, (name, expression, unit) in enumerate(labels)
    ]


def text(agreement: Agreement) -> str:
    """Text for the terminal: the sentence, and a table of the coefficients with the largest ratios."""
    worst = np.flatnonzero(agreement.compared)
    worst = worst[np.argsort(-agreement.ratio[worst], kind="stable")][: TUNING.worst_coefficients]
    if not len(worst):
        return agreement.sentence
    rows = []
    for c in worst:
        name, mean = f"{agreement.names[c]}, {agreement.units[c]}", f"{agreement.mean[c]:.4g}"
        spread, typical = f"{agreement.spread[c]:.3g}", f"{agreement.typical_sd[c]:.3g}"
        tests = f"{agreement.ratio[c]:.1f}", f"{agreement.p[c]:.1g}"
        rows.append([name, str(agreement.runs[c]), mean, spread, typical, *tests])
    headings = ["coefficient", "runs", "mean", "spread", "typical sd", "ratio", "p"]
    return f"{agreement.sentence}\n{table(headings, rows)}"
