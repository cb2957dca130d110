"""The benchmark of samplers: NUTS samples the same density, and the script runs."""

import numpy as np
import pytest

from bayesid.posterior.sampler import Sampling, sample
from bayesid.studies.benchmarks import posterior as benchmark_posterior
from bayesid.studies.benchmarks.nuts_coordinates import Linear, LogCholesky, make_log_density, numpyro_installed
from bayesid.studies.benchmarks.posterior import main, simulated_problem

needs_numpyro = pytest.mark.skipif(not numpyro_installed(), reason="numpyro is not installed")


@pytest.fixture(scope="module")
def jax():
    module = pytest.importorskip("jax")
    module.config.update("jax_enable_x64", True)
    return module


@pytest.fixture(scope="module")
def problem():
    """Its prior has everything: bodies, friction, offsets, windows on radii and total mass."""
    return simulated_problem(terms=("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset"))


@pytest.fixture(scope="module")
def points(problem):
    """Interior points: those that start, and draws of the posterior, which come closer to the walls."""
    draws = sample(problem.target, problem.theta, Sampling(walkers=2, first_check=8, max_sweeps=8, warm_up=8))
    return np.concatenate([problem.starts(16), draws.coordinates[-16:]])


@pytest.fixture(scope="module", params=[LogCholesky, Linear])
def chosen(request, problem, points):
    return request.param(problem, points)


@needs_numpyro
def test_coordinates_are_a_map_whose_jacobian_and_density_are_exact(jax, problem, points, chosen):
    z = chosen.back(points)
    again, volume = forward(jax, chosen, z)
    assert np.max(np.abs(again - points) / np.abs(points).max(axis=0)) < 1e-9
    jacobian = np.array(jax.jit(jax.vmap(jax.jacobian(lambda point: chosen.forward(point)[0])))(z))
    np.testing.assert_allclose(volume, np.linalg.slogdet(jacobian)[1], rtol=1e-8)
    values = np.array(jax.jit(jax.vmap(make_log_density(problem, chosen)))(z))
    np.testing.assert_allclose(values, problem.target.log_density(points) + volume, rtol=1e-8)


@needs_numpyro
def test_all_of_space_maps_into_the_region(jax, problem, points, chosen, rng):
    z = chosen.back(points)
    wild = z.mean(axis=0) + 1.5 * z.std(axis=0) * rng.standard_normal((200, z.shape[1]))
    theta = forward(jax, chosen, wild)[0][:, : chosen.n_parameters]
    prior = problem.target.prior
    light = theta[:, problem.cone.bodies[:, 9]].sum(axis=1) < 300.0
    assert light.sum() > 20
    assert np.all(prior.region.excess(theta[light].T, prior.inside) < 1e-9)
    values = np.array(jax.jit(jax.vmap(make_log_density(problem, chosen)))(wild))
    np.testing.assert_array_equal(np.isfinite(values), light)


def forward(jax, chosen, z):
    """(W, P + n) coordinates and (W,) log |Jacobian|."""
    inner, volume = jax.jit(jax.vmap(chosen.forward))(z)
    return np.array(inner), np.array(volume)


@pytest.mark.long
@pytest.mark.parametrize("numpyro", [pytest.param(True, marks=needs_numpyro), False])
def test_the_study_runs(monkeypatch, capsys, numpyro):
    monkeypatch.setattr(benchmark_posterior, "numpyro_installed", lambda: numpyro)
    main(["--short", "--seconds", "0.5"])
    shown = capsys.readouterr().out
    assert "emcee stretch" in shown
    assert ("NUTS linear" in shown) == numpyro
    assert ("pip install 'bayesid[bench]'" in shown) != numpyro
    assert shown.count("target >=") == 1 + numpyro
