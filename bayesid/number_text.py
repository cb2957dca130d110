"""Numbers in text: digits, standard deviations and percentages, alike on pages, in tables and in the terminal."""

from __future__ import annotations

import math


def rounded(value: float, digits: int = 3) -> str:
    """A number to some significant digits, trailing zeros kept."""
    if not math.isfinite(value):
        return "unknown" if math.isnan(value) else "-infinite" if value < 0.0 else "infinite"
    if value and not 1e-4 <= abs(value) < 1e6:  # as Python's `repr`
        return f"{value:.{digits - 1}e}"
    return f"{value:.{_decimals(value, digits)}f}"


def quantity(value: float, sd: float, unit: str = "") -> str:
    """1.9 +- 0.4 N m, 1.94 +- 0.12 N m: the deviation to one or two digits by the PDG's rule; none if unknown.

    The unit "1" is not written; nor is the sign of a value that is rounded to zero.
    """
    of_unit = "" if unit in ("", "1") else f" {unit}"
    if not math.isfinite(value) or not math.isfinite(sd) or sd <= 0.0:
        return f"{rounded(value)}{of_unit}"
    exponent = math.floor(math.log10(max(abs(value), sd)))
    scaled = not -4 <= exponent < 6
    factor = 10.0**exponent if scaled else 1.0
    decimals = _decimals_of_deviation(sd / factor)
    numbers = f"{value / factor:z.{decimals}f} +- {sd / factor:.{decimals}f}"
    return f"({numbers})e{exponent}{of_unit}" if scaled else f"{numbers}{of_unit}"


def percent(share: float, decimals: int | None = None) -> str:
    """5 %: a share with so many decimals, or to two significant digits."""
    return f"{rounded(100.0 * share, 2) if decimals is None else f'{100.0 * share:.{decimals}f}'} %"


def _decimals_of_deviation(sd: float) -> int:
    """Three leading digits up to 354 are rounded to two, up to 949 to one, others to 1000 with two (PDG, 5.3)."""
    leading, exponent = f"{sd:.2e}".split("e")
    if float(leading) > 9.49:
        return _decimals(10.0 ** (int(exponent) + 1), 2)
    return _decimals(sd, 2 if float(leading) <= 3.54 else 1)


def _decimals(value: float, digits: int) -> int:
    """Decimals of a number that is rounded to some significant digits."""
    return max(0, digits - 1 - int(f"{value:.{digits - 1}e}".split("e")[1]))
