"""The parameters that predict: a posterior's likeliest, all joints' residuals taken for equally slow.

A posterior's mean is the best guess of parameters if the model is right. On a real robot what is left is the model's
error, not noise, and of a short log two things then carry the mean away from what fits: joints whose residual looks
slow hardly count, and where little counts, the cone's volume speaks: most feasible links are heavier than the likeliest
one. On halves of real logs, 5 to 10 s, the mean then predicts worse than weighted least squares in the cone
(docs/peers.md). So what predicts is :eq:`predicting-mode`::

    the maximum over the cone of  -sum_j |r_j(theta)|^2 / (2 tau s_j^2) + log p(theta),

with r_j the residuals of joint j and s_j their sd, as in weighted least squares, p the prior, and tau the
autocorrelation time of all joints' residuals, their geometric mean, so that the prior counts as much as it should.
"""

from __future__ import annotations

import numpy as np

from bayesid.arrays import Array
from bayesid.fit.noise import Noise
from bayesid.fit.solver import ConeLeastSquares
from bayesid.model.coefficients import BaseCoefficients
from bayesid.model.parameters import Cone
from bayesid.posterior.target import Target


def predicting(
    target: Target, cone: Cone, coefficients: BaseCoefficients, theta: Array, noise: Noise, residual: Noise
) -> Array:
    """(P,) the parameters that predict.

    Args:
        target: the posterior.
        cone: of its P parameters.
        coefficients: their r base coefficients.
        theta: (P,) whose predictions say which signs to expect where they are unknown.
        noise: in whose units the target's moments are.
        residual: of the fit.

    Raises:
        SolverError: the cone problem could not be solved.
    """
    likelihood, prior = target.likelihood, target.prior
    slow = float(np.exp(np.mean(np.log(residual.autocorrelation))))
    weight = noise.sigma**2 * noise.autocorrelation / (residual.sigma**2 * slow)
    hessian = np.einsum("j,jrs->rs", weight, likelihood.hessian)
    push = likelihood.push(theta[None], np.zeros((1, likelihood.n_joints)))[0]
    signs = np.where(likelihood.fixed != 0, likelihood.fixed, np.tanh(push))
    gradient = (signs * weight[likelihood.joint]) @ likelihood.gradient
    if target.information is not None:
        hessian, gradient = hessian + target.information.hessian, gradient + target.information.gradient
    stated = ConeLeastSquares.with_prior(cone, coefficients, hessian, prior.mean, prior.sd)
    return stated.prepared().solve_precisely(gradient).theta
