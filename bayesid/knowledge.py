"""What an earlier log has told about a model's parameters: a normal distribution of the coefficients it could show."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.coefficients import BaseCoefficients, base_coefficients, embedding
from bayesid.model import Model
from bayesid.motion import Array

_NOTHING = 1e-12
"""Share of the largest diagonal entry below which one is rounding itself."""


@dataclass(frozen=True)
class Information:
    """What is known of r coefficients: (beta' H beta - 2 g' beta + c) / 2 is minus its logarithm, as that of moments.

    Attributes:
        hessian: (r, r) H.
        gradient: (r,) g.
        energy: c.
    """

    hessian: Array
    gradient: Array
    energy: float

    def misfit(self, beta: Array) -> float:
        """The quadratic form of coefficients (r,)."""
        return float(beta @ self.hessian @ beta - 2.0 * self.gradient @ beta + self.energy)

    @classmethod
    def none(cls, size: int) -> Information:
        """Nothing is known."""
        return cls(np.zeros((size, size)), np.zeros(size), 0.0)


@dataclass(frozen=True)
class Knowledge:
    """A normal distribution of the base coefficients of a model.

    Attributes:
        model: robot and terms.
        theta: (P,) parameters; the distribution is centred on their coefficients.
        precision: (r, r) inverse covariance of the r base coefficients; singular where a log has shown nothing.
    """

    model: Model
    theta: Array
    precision: Array

    def coefficients(self, model: Model) -> BaseCoefficients:
        """The base coefficients of an extended model: what a log and this knowledge can show together."""
        return base_coefficients(model, earlier=self.model)

    def information(self, model: Model, coefficients: BaseCoefficients) -> Information:
        """The same in the coefficients of an extended model (see `coefficients`)."""
        own = base_coefficients(self.model)
        turn = own.projection @ embedding(self.model, model) @ np.linalg.pinv(coefficients.projection)
        centre = own.project(self.theta)
        hessian = turn.T @ self.precision @ turn
        gradient = turn.T @ (self.precision @ centre)
        return Information(0.5 * (hessian + hessian.T), gradient, float(centre @ self.precision @ centre))

    def widened(self, names: tuple[str, ...], sd: Array) -> Knowledge:
        """The same, but that these parameters may have changed, by a normal step of standard deviations sd (p,).

        (C + B D B')^-1 = L - L B (D^-1 + B' L B)^-1 B' L with L = C^-1 (Woodbury).
        """
        labels = [parameter.name for parameter in self.model.parameters]
        steps = base_coefficients(self.model).projection[:, [labels.index(name) for name in names]]
        pulled = self.precision @ steps
        middle = np.diag(1.0 / sd**2) + steps.T @ pulled
        return replace(self, precision=self.precision - pulled @ np.linalg.solve(middle, pulled.T))


def of_base(model: Model, coefficients: BaseCoefficients, precision: Array) -> Array:
    """(r, r) precision of the model's own base coefficients, from that (R, R) of others that tell as much or more.

    With an earlier log a payload can be told from the last link, which the model without that log cannot say: what is
    more is integrated out.
    """
    own = base_coefficients(model)
    if own.names == coefficients.names:
        return precision
    turn = own.projection @ np.linalg.pinv(coefficients.projection)
    across, more = np.linalg.pinv(turn), np.linalg.svd(turn)[2][len(turn) :].T
    scale = scale_of(more.T @ precision @ more)
    kept, mixed = across.T @ precision @ across, across.T @ precision @ more / scale
    inner = np.linalg.pinv(more.T @ precision @ more / scale[:, None] / scale, rcond=_NOTHING, hermitian=True)
    reduced: Array = kept - mixed @ inner @ mixed.T
    return 0.5 * (reduced + reduced.T)


def scale_of(precision: Array) -> Array:
    """(r,) what brings the diagonal to one, up to entries that are rounding: coefficients have units of all kinds."""
    diagonal = np.abs(np.diag(precision))
    scale: Array = np.sqrt(np.maximum(diagonal, _NOTHING * float(diagonal.max()))) + np.finfo(float).tiny
    return scale
