from itertools import product

import numpy as np
from posterior_problems import likelihood, simulate, target_in, whole_space
from scipy.special import logsumexp


def brute_force(columns, effort, joint, segment, known, theta, log_scale):
    """Log likelihood and P(+) by summing over all signs, row by row."""
    logs, signs = [], []
    for choice in product([-1, 1], repeat=segment.max() + 1):
        if np.any((known != 0) & (known != choice)):
            continue
        sd = np.exp(log_scale[joint])
        residual = (np.array(choice)[segment] * effort - columns @ theta) / sd
        logs.append(np.sum(-0.5 * residual**2 - np.log(sd)))
        signs.append(choice)
    weight = np.exp(np.array(logs) - logsumexp(logs))
    return logsumexp(logs), weight @ (np.array(signs) == 1)


def test_sum_over_signs_is_exact(rng):
    columns, effort = rng.standard_normal((30, 3)), np.abs(rng.standard_normal(30))
    segment = np.arange(30) % 7
    joint = segment % 2
    known = np.array([1, 0, 0, -1, 0, 0, 0])
    data = likelihood(columns, effort, joint, segment, known, 2)
    theta, log_scale = rng.standard_normal((5, 3)), 0.3 * rng.standard_normal((5, 2))
    ours = data.log_likelihood(theta, log_scale)
    plus = data.plus_probability(theta, log_scale)
    for k in range(5):
        expected, probability = brute_force(columns, effort, joint, segment, known, theta[k], log_scale[k])
        assert np.isclose(ours[k], expected, rtol=1e-12)
        assert np.allclose(plus[k][known == 0], probability[known == 0], atol=1e-12)
    total = data.pointwise(theta, log_scale).sum(axis=1)
    weight = np.exp(-2 * log_scale)
    rest = -np.sum(weight * (data.curvature(theta) + data.energy), axis=1) / 2 - log_scale @ data.count
    assert np.allclose(total + rest, ours)


def test_conditional_gradient_is_the_gradient_for_given_signs(rng):
    target = simulate(target_in(whole_space(3), np.zeros(3)), rng.standard_normal(3), np.zeros(2), rng)
    data = target.likelihood
    beta, log_scale = rng.standard_normal((1, 3)), 0.2 * rng.standard_normal((1, 2))
    signs = rng.choice([-1.0, 1.0], (1, len(data.unknown)))

    def log_density(b):
        return -0.5 * np.sum(np.exp(-2 * log_scale) * data.residual(b, signs))

    numeric = [(log_density(beta + 1e-5 * e) - log_density(beta - 1e-5 * e)) / 2e-5 for e in np.eye(3)]
    assert np.allclose(data.conditional_gradient(beta, log_scale, signs)[0], numeric, rtol=1e-6)
