"""What a sampled posterior adds to a result folder."""

import json
import shutil
import tomllib

import arviz as az
import numpy as np
import pytest
import tomli_w
from saved_results import numbers, save, strict, table
from saved_results import sampled as sample

import bayesid
from bayesid.effects import STANDARD
from bayesid.errors import InputError
from bayesid.identification.model_file import load

KEYS = {
    *("converged", "max_rhat", "min_ess", "max_rhat_of_parameters", "draws", "ensembles", "walkers", "seed", "seconds"),
    *("prior", "prior_sd", "noise_scale", "mode", "assignments", "assignments_elsewhere", "posterior_conflict"),
    "active_bounds",
    "timed_out",
    *("wanted_rhat", "wanted_ess"),
}


@pytest.fixture(scope="module")
def sampled():
    return sample()


@pytest.fixture(scope="module")
def folder(sampled, tmp_path_factory):
    return save(sampled, tmp_path_factory.mktemp("sampled") / "result")


def draws_in(folder):
    """(K, P), (K, r) and (K, n) as ArviZ reads them, and the file's attributes."""
    data = az.from_netcdf(folder / "posterior.nc")
    theta, beta, noise = (data.posterior[name].values for name in ("theta", "beta", "noise"))
    return *(values.reshape(-1, values.shape[-1]) for values in (theta, beta, noise)), data


def test_coefficients_are_those_of_the_draws(sampled, folder):
    """Of those in the file, of which some may have been left out: within a tenth of an sd, quantiles a fifth."""
    _, beta, _, data = draws_in(folder)
    rows = table(folder / "coefficients.csv")
    assert data.posterior.coefficient.values.tolist() == [row["name"] for row in rows]
    mean, sd, relative, low, high = numbers(rows, "mean", "sd", "rsd_percent", "q2.5", "q97.5").T
    posterior = sampled.posterior
    of_log, every = (draws.beta.reshape(-1, len(rows)) for draws in (posterior.draws, posterior.uncertain))
    np.testing.assert_allclose(mean, of_log.mean(axis=0), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(sd, np.sqrt(np.mean((every - of_log.mean(axis=0)) ** 2, axis=0)), rtol=1e-3)
    np.testing.assert_allclose(relative, 100.0 * sd / np.abs(mean), rtol=1e-6)
    free = np.array([not row["name"].startswith(("Fv", "Fc", "Ia")) for row in rows])  # else it is the shortest one
    for end, share in ((low, 0.025), (high, 0.975)):
        np.testing.assert_allclose(end[free], np.quantile(every, share, axis=0)[free], rtol=1e-7, atol=1e-12)
        assert np.abs(end - np.quantile(beta, share, axis=0))[free].max() < 0.2 * sd.max()
    np.testing.assert_allclose(np.mean((every >= low) & (every <= high), axis=0), 0.95, atol=2e-3)
    assert np.abs((beta.mean(axis=0) - every.mean(axis=0)) / sd).max() < 0.1
    assert np.abs((every.mean(axis=0) - mean) / sd).max() < 0.25, "the cone holds some moves back"
    assert np.all((low < mean) & (mean < high))


def test_the_model_is_the_mean_and_feasible(sampled, folder):
    theta, _, noise, _ = draws_in(folder)
    loaded = load(folder)
    mean = sampled.posterior.draws.theta.reshape(-1, theta.shape[1]).mean(axis=0)
    np.testing.assert_allclose(loaded.theta, mean, rtol=1e-9, atol=1e-12)
    assert np.abs((theta.mean(axis=0) - mean) / theta.std(axis=0)).max() < 0.3, "links' own parameters mix slowly"
    assert loaded.model.cone.contains(loaded.theta)
    assert loaded.model.cone.smallest_eigenvalues(loaded.theta).min() > 0.0
    np.testing.assert_array_equal(loaded.draws.theta, theta)
    np.testing.assert_array_equal(loaded.draws.sigma, noise)
    rows = table(folder / "parameters.csv")
    off = sampled.posterior.uncertain.theta.reshape(-1, theta.shape[1]) - mean
    np.testing.assert_allclose(numbers(rows, "mean"), loaded.theta, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(numbers(rows, "sd"), np.sqrt(np.mean(off**2, axis=0)), rtol=1e-8)


def test_what_decides_a_parameter(sampled, folder):
    """At most a tenth of the prior's variance left, in the normal distribution of prior and least squares."""
    rows = table(folder / "parameters.csv")
    prior = json.loads((folder / "summary.json").read_text())["posterior"]["prior_sd"]
    assert list(prior) == [row["name"] for row in rows]
    sd, projection = np.array(list(prior.values())), sampled.coefficients.projection
    precision = projection.T @ np.linalg.solve(sampled.fit.covariance, projection) + np.diag(sd**-2.0)
    left = np.diag(np.linalg.inv(precision)) / sd**2
    clear = (left < 0.05) | (left > 0.2)
    assert clear.mean() > 0.7
    decided = {row["name"]: row["decided_by"] for row in rows}
    for name, share in zip(decided, left, strict=True):
        if not 0.05 < share < 0.2:
            assert decided[name] == ("data" if share < 0.1 else "prior"), name
    assert (decided["Fv1"], decided["offset3"], decided["m1"]) == ("data", "data", "prior")


def test_the_summary_tells_the_posterior(sampled, folder):
    content = strict((folder / "summary.json").read_text())
    told, search, draws = content["posterior"], content["search"], sampled.posterior.draws
    assert set(told) == KEYS
    assert search["cost_parts"]["data"] + search["cost_parts"]["tikhonov"] == pytest.approx(search["cost"])
    assert told["converged"] is True
    assert 0.99 < told["max_rhat"] <= 1.01
    assert told["min_ess"] >= 400.0
    assert told["draws"] == draws.theta[..., 0].size == draws.sweeps * told["ensembles"] * told["walkers"]
    assert told["seed"] == 3
    np.testing.assert_allclose(told["noise_scale"], np.exp(draws.log_scale).reshape(-1, 3).mean(axis=0))
    assert sum(mode["weight"] for mode in content["modes"]) == pytest.approx(1.0)
    assert len(told["assignments"]) == search["assignments"]
    assert sum(told["assignments"]) + told["assignments_elsewhere"] == pytest.approx(1.0)


def test_the_file_of_draws_says_where_it_comes_from(sampled, folder):
    _, _, noise, data = draws_in(folder)
    assert (data.attrs["robot"], data.attrs["converged"], data.attrs["seed"]) == ("arm3", 1, 3)
    assert json.loads(data.attrs["terms"]) == list(STANDARD)
    assert data.attrs["bayesid_version"] == bayesid.__version__
    assert {"numpy_version", "emcee_version", "arviz_version"} <= set(data.attrs)
    assert data.posterior.joint.values.tolist() == ["A1", "A2", "A3"]
    assert data.posterior.sizes["chain"] * data.posterior.sizes["draw"] <= 4096
    np.testing.assert_allclose(data.constant_data.sigma_ref, sampled.posterior.noise.sigma)
    np.testing.assert_allclose(noise.mean(axis=0), sampled.fit.noise.sigma, rtol=0.2)
    assert data.observed_data.start.values.min() >= 1.7e9
    assert data.observed_data.end.values.max() <= sampled.log.t[-1]


def test_damaged_draws_are_bad_input(folder, tmp_path):
    """One line that names the file, not a model without its draws; nor are those of another model taken."""
    place = shutil.copytree(folder, tmp_path / "r")
    path, whole = place / "posterior.nc", (folder / "posterior.nc").read_bytes()
    other = tomllib.loads((place / "model.toml").read_text())
    other["terms"] = [term for term in other["terms"] if term["name"] != "torque_offset"]
    del other["knowledge"]
    for content in (whole[: len(whole) // 2], b"draws", b"", None):
        if content is None:
            path.write_bytes(whole)
            (place / "model.toml").write_text(tomli_w.dumps(other))
        else:
            path.write_bytes(content)
        with pytest.raises(InputError) as refusal:
            load(place)
        assert refusal.value.where == str(path)
        assert "\n" not in str(refusal.value)
    path.unlink()
    assert load(place).draws is None
