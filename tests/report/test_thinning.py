"""Thinning and averaging of samples for figures."""

import numpy as np

from bayesid.report.report_data import binned, envelope, evenly


def test_rows_are_spread_evenly_from_end_to_end():
    for count, most in ((10, 4), (1000, 7), (5, 5), (3, 10), (2, 2), (1, 1), (40_001, 40_000)):
        rows = evenly(count, most)
        assert len(rows) == min(count, most)
        assert rows[0] == 0
        assert rows[-1] == (count - 1 if len(rows) > 1 else 0)
        steps = np.diff(rows)
        assert steps.max(initial=1) - steps.min(initial=steps[0] if len(steps) else 1) <= 1


def test_bins_by_hand():
    """Four samples make two bins; the standard error of two values a and b is |a - b| / 2."""
    value = np.array([3.0, 1.0, 2.0, 5.0])
    residual = np.array([10.0, -1.0, 4.0, 16.0])
    centre, mean, error = binned(value, residual)
    np.testing.assert_allclose(centre, [1.5, 4.0])
    np.testing.assert_allclose(mean, [1.5, 13.0])
    np.testing.assert_allclose(error, [2.5, 3.0])


def test_bins_have_at_least_two_samples_and_equally_many():
    for count, bins in ((0, 0), (1, 0), (2, 1), (3, 1), (47, 23), (48, 24), (1000, 24)):
        centre, mean, error = binned(np.arange(count, dtype=float), np.ones(count))
        assert len(centre) == len(mean) == len(error) == bins
        assert not error.any()
    value = np.linspace(-1.0, 1.0, 2400)
    centre, mean, error = binned(value, np.where(np.arange(2400) % 2, 1.5, 0.5))
    np.testing.assert_allclose(np.diff(centre), np.ptp(value) / 2399 * 100, rtol=1e-9)
    np.testing.assert_allclose(mean, 1.0, rtol=1e-12)
    np.testing.assert_allclose(error, 0.5 * np.sqrt(100 / 99) / 10.0, rtol=1e-12)


def test_an_envelope_keeps_every_peak(rng):
    """As on a screen: no pixel column loses its highest or its lowest sample."""
    values = rng.standard_normal(10_000)
    values[[1234, 7777]] = 50.0, -60.0
    rows = envelope(values, 400)
    assert len(rows) <= 402
    assert np.all(np.diff(rows) > 0)
    assert (rows[0], rows[-1]) == (0, 9999)
    assert {1234, 7777} <= set(rows.tolist())
    for stretch in range(200):
        inside = slice(stretch * 50, stretch * 50 + 50)
        mine = values[rows[(rows >= inside.start) & (rows < inside.stop)]]
        assert (mine.min(), mine.max()) == (values[inside].min(), values[inside].max())
