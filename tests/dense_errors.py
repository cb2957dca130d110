"""Errors of efforts as dense matrices, white noise beside an AR(1) process, and densities of efforts by them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from bayesid.regression.selection.fitted_effects import Observations


def covariance(error, count):
    """(count, count) white on the diagonal, and exp(-|dt| / T)."""
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) / error.rate
    return error.white**2 * np.eye(count) + error.coloured**2 * np.exp(-apart / error.correlation)


def bridging(used):
    """(N, N) matrix that puts what is not used on straight lines between its used neighbours."""
    places, rows = np.arange(len(used)), np.flatnonzero(used)
    return np.stack([np.interp(places, rows, np.eye(len(used))[rows, k]) for k in places], axis=1)


def whitening(error, count):
    """(count, count) T with T x white, of unit size: x_i - phi x_(i-1) is a moving average of order one, from rest."""
    phi = np.exp(-1.0 / (error.correlation * error.rate))
    own = error.coloured**2 * (1.0 - phi**2) + error.white**2 * (1.0 + phi**2)
    next_to = -phi * error.white**2
    theta = min(np.roots([next_to, own, next_to]).real, key=abs)
    shift = np.eye(count, k=-1)
    return np.linalg.solve(np.eye(count) - theta * shift, np.eye(count) - phi * shift) / np.sqrt(-next_to / theta)


@dataclass
class Dense:
    """The used samples of all joints below each other: columns, effort and covariance of the error."""

    data: Observations
    errors: tuple

    @property
    def used(self):
        return [np.flatnonzero(mask) for mask in self.data.used.T]

    def stacked(self, of_joint):
        return np.concatenate([of_joint(j)[rows] for j, rows in enumerate(self.used)])

    def rows(self, effects):
        count = len(self.data.effort)
        parts = [self.stacked(lambda j: self.data.columns[:, j])]
        for one in effects:
            blank = np.zeros((count, len(one.sd)))
            parts.append(self.stacked(lambda j, one=one, blank=blank: one.rows.get(j, blank)))
        return np.concatenate(parts, axis=1)

    def effort(self, effects=()):
        left = self.stacked(lambda j: self.data.effort[:, j])
        blank = np.zeros(len(self.data.effort))
        for one in effects:
            left = left - self.stacked(lambda j, one=one: one.shift.get(j, blank))
        return left

    def covariance(self):
        blocks = []
        for error, used in zip(self.errors, self.data.used.T, strict=True):
            of_used = np.ix_(used, used)
            inverse = np.linalg.inv((whitening(error, len(used)) @ bridging(used))[of_used])
            blocks.append(inverse @ inverse.T)
        return block_diag(*blocks)

    def least_squares(self, effects=()):
        """Coefficients and amplitudes with their covariance."""
        rows, inverse = self.rows(effects), np.linalg.inv(self.covariance())
        known = self.data.information
        prior = block_diag(known.hessian, *(np.diag(1.0 / one.sd**2) for one in effects))
        pull = np.concatenate([known.gradient, *(np.zeros(len(one.sd)) for one in effects)])
        spread = np.linalg.inv(prior + rows.T @ inverse @ rows)
        return spread @ (pull + rows.T @ inverse @ self.effort(effects)), spread

    def log_density(self, effects=()):
        """Of the efforts, coefficients and amplitudes integrated out, the earlier log a proper prior."""
        known = self.data.information
        spread = block_diag(np.linalg.inv(known.hessian), *(np.diag(one.sd**2) for one in effects))
        centre = np.concatenate([np.linalg.solve(known.hessian, known.gradient), np.zeros(len(spread) - 3)])
        rows = self.rows(effects)
        total = self.covariance() + rows @ spread @ rows.T
        return multivariate_normal(rows @ centre, total).logpdf(self.effort(effects))

    def log_likelihood_of(self, effect, amplitudes):
        """(K,) of the efforts given amplitudes (K, p) of an effect, coefficients integrated out."""
        known, rows = self.data.information, self.rows(())
        total = self.covariance() + rows @ np.linalg.solve(known.hessian, rows.T)
        columns = self.rows((effect,))[:, rows.shape[1] :]
        left = self.effort((effect,)) - rows @ np.linalg.solve(known.hessian, known.gradient)
        return multivariate_normal(np.zeros(len(left)), total).logpdf(left - amplitudes @ columns.T)
