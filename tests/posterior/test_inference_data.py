import json
import warnings
from contextlib import suppress
from dataclasses import replace

import arviz as az
import numpy as np
import pytest
import xarray
from posterior_logs import make_log
from posterior_problems import one_each

from bayesid.effects.coefficients import BaseCoefficients
from bayesid.effects.parameters import Parameter
from bayesid.errors import InputError
from bayesid.posterior.inference_data import Labels, as_inference_data, keep, read_coefficients, read_draws, write
from bayesid.posterior.likelihood import make_likelihood, pointwise
from bayesid.posterior.sampler import Diagnostics, Draws
from bayesid.regression.knowledge import InformationMatrix

JOINTS = ("A1", "A2", "A3")
SIGMA = np.array([0.5, 2.0, 1.3])
AUTOCORRELATION = np.array([4.0, 1.0, 7.5])
PROJECTION = np.array([[1.0, 0.0, 0.0, 0.7, 0.0], [0.0, 1.0, 0.0, 0.0, -0.4], [0.0, 0.0, 1.0, 0.2, 1.0]])
THETA = np.array([1.0, -0.6, 0.8, 0.3, -0.2])


class Problem:
    """A log of 24 segments in three joints, three of known sign, and its posterior."""

    def __init__(self, own=None, fixed=()):
        rows, known = np.random.default_rng(5).integers(20, 60, 24), np.isin(np.arange(24), (3, 9, 11))
        made = {"joint": np.arange(24) % 3, "known": known, "sigma": SIGMA, "time": AUTOCORRELATION, "seed": 3}
        log = make_log(THETA, rows, projection=PROJECTION, sd=np.full(5, 2.0), **made)
        self.rows, self.effort = zip(*log.rows, strict=True)
        self.normal_equations = log.normal_equations if own is None else log.normal_equations.compact(own)
        coefficients = BaseCoefficients(
            ("m1", "fv1", "Ia1"), ("m1 + 0.7 m2", "fv1", "Ia1"), ("kg", "N m s", "kg m2"), np.arange(3), PROJECTION
        )
        branch = np.isin(np.arange(24), fixed).astype(int)
        likelihood = make_likelihood(self.normal_equations, coefficients, SIGMA, AUTOCORRELATION, branch)
        self.target = replace(log.target, likelihood=likelihood)
        parameters = [Parameter(f"p{k}", "kg", 1) for k in range(5)]
        time = [np.linspace(0.5 * k, 0.5 * k + 0.4, len(y)) for k, y in enumerate(self.rows)]
        self.labels = Labels(coefficients, parameters, JOINTS, np.concatenate(time))

    def draws(self, sweeps=40, ensembles=4, walkers=8, seed=0):
        """From the normal approximation at the truth, which is close to the posterior."""
        rng = np.random.default_rng(seed)
        precision, pull = self.target.quadratic(THETA, np.zeros(3))
        factor = np.linalg.cholesky(np.linalg.inv(precision))
        shape = (sweeps, ensembles, walkers)
        theta = np.linalg.solve(precision, pull) + rng.standard_normal((*shape, 5)) @ factor.T
        log_scale = rng.standard_normal((*shape, 3)) / np.sqrt(2.0 * self.target.likelihood.count)
        return self.of(theta, log_scale)

    def of(self, theta, log_scale):
        joined = np.concatenate([theta, log_scale], axis=-1)
        density = self.target.log_density(joined.reshape(-1, 8)).reshape(theta.shape[:3])
        none = Diagnostics(np.ones(1), np.ones(1), np.ones(1))
        return Draws(theta, log_scale, theta @ PROJECTION.T, density, none, none, True, 1.0)

    def kept(self, draws=None, attributes=None, **options):
        draws = self.draws() if draws is None else draws
        attributes = attributes or {"seed": 3}
        return keep(draws, self.target, one_each(self.normal_equations), self.labels, attributes, **options)

    def data(self, *given, **options):
        return as_inference_data(self.kept(*given, **options))


@pytest.fixture
def data(tmp_path):
    write(Problem().kept(), tmp_path / "posterior.nc")
    return az.from_netcdf(tmp_path / "posterior.nc")


def test_groups_dimensions_and_names(data):
    assert set(data) == {"posterior", "sample_stats", "log_likelihood", "observed_data", "constant_data"}
    posterior, constant = data.posterior, data.constant_data
    assert dict(posterior.sizes) == {"chain": 4, "draw": 320, "coefficient": 3, "parameter": 5, "joint": 3}
    for name, last in (("beta", "coefficient"), ("theta", "parameter"), ("noise", "joint")):
        assert posterior[name].dims == ("chain", "draw", last)
        assert posterior[name].dtype == np.float64
    for group in (posterior, data.sample_stats):
        assert set(group.coords) - set(group.dims) == {"mode"}, "any other ends `az.summary` of ArviZ 1.x"
    labels = {"coefficient": ["m1", "fv1", "Ia1"], "parameter": ["p0", "p1", "p2", "p3", "p4"], "joint": list(JOINTS)}
    assert {name: posterior[name].values.tolist() for name in labels} == labels
    assert posterior.noise.attrs["units"] == "N m"
    assert {data.sample_stats[name].dims for name in ("lp", "walker", "sweep")} == {("chain", "draw")}
    assert data.log_likelihood.effort.dims == ("chain", "draw", "block")
    assert data.log_likelihood.effort.dtype == np.float32
    for name, values in (("sigma_ref", SIGMA), ("autocorrelation", AUTOCORRELATION), ("projection", PROJECTION)):
        np.testing.assert_allclose(constant[name], values)
    assert np.allclose(constant.prior_sd, 2.0)
    assert constant.coefficient_unit.values.tolist() == ["kg", "N m s", "kg m2"]
    assert constant.coefficient_expression.values[0] == "m1 + 0.7 m2"
    assert constant.parameter_unit.values.tolist() == ["kg"] * 5


def test_information_of_an_earlier_log_is_stored(tmp_path):
    problem = Problem()
    root = np.array([[2.0, 0.3, 0.0], [0.0, 1.0, -0.7]])
    known = InformationMatrix(root.T @ root, np.array([0.4, -1.0, 0.2]), 3.5)
    assert not any(str(name).startswith("earlier") for name in problem.data().constant_data)
    without = problem.data().sample_stats.lp.values
    problem.target = replace(problem.target, information=known)
    draws = Problem().draws()
    write(problem.kept(problem.of(draws.theta, draws.log_scale)), tmp_path / "posterior.nc")
    made = az.from_netcdf(tmp_path / "posterior.nc")
    kept, beta = made.constant_data, made.posterior.beta.values
    misfit = np.einsum("cdr,rs,cds->cd", beta, kept.earlier_hessian.values, beta)
    misfit += float(kept.earlier_energy) - 2.0 * beta @ kept.earlier_gradient.values
    assert np.allclose(made.sample_stats.lp.values, without - 0.5 * misfit, rtol=1e-12)
    assert kept.earlier_gradient.values.tolist() == known.gradient.tolist()
    assert misfit.min() > 0.0


def test_blocks_are_named_and_measured(data):
    observed, problem = data.observed_data, Problem()
    assert np.array_equal(observed.block, data.log_likelihood.block)
    assert len(set(observed.block.values.tolist())) == 24
    assert (observed.block.values[4], observed.joint.values[4]) == ("A2 2.00-2.40 s", "A2")
    assert np.allclose([observed.start[4], observed.end[4]], [2.0, 2.4])
    assert observed.n_samples.values.tolist() == [len(y) for y in problem.rows]
    assert np.allclose(observed.effort, [np.sqrt(np.mean(e**2)) for e in problem.effort])
    assert np.allclose(observed.effort_energy, [np.sum(e**2) for e in problem.effort])
    assert observed.n_unknown.values.tolist() == [int(k not in (3, 9, 11)) for k in range(24)]
    assert observed.fixed_sign.values.tolist() == problem.normal_equations.known.tolist()


def test_draws_are_in_walker_major_order(data):
    problem, stats = Problem(), data.sample_stats
    draws = problem.draws()
    for chain, draw in ((0, 0), (2, 41), (3, 319)):
        at = {"chain": chain, "draw": draw}
        walker, sweep = int(stats.walker.sel(at)), int(stats.sweep.sel(at))
        assert (walker, sweep) == divmod(draw, 40)
        assert np.array_equal(data.posterior.theta.sel(at), draws.theta[sweep, chain, walker])
        assert np.array_equal(data.posterior.beta.sel(at), draws.beta[sweep, chain, walker])
        assert np.allclose(data.posterior.noise.sel(at), SIGMA * np.exp(draws.log_scale[sweep, chain, walker]))
        assert float(stats.lp.sel(at)) == draws.log_density[sweep, chain, walker]
        one = (values[sweep, chain, walker][None] for values in (draws.theta, draws.log_scale))
        terms = pointwise(problem.target.likelihood, problem.normal_equations, *one)[0]
        assert np.allclose(data.log_likelihood.effort.sel(at), terms, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("most", "every"), [(1280, 1), (1279, 2), (100, 14), (1, 40)])
def test_whole_sweeps_are_left_out_evenly(most, every):
    made = Problem().data(most=most)
    sweeps = np.unique(made.sample_stats.sweep)
    assert made.attrs["kept_every"] == every
    assert sweeps[-1] == 39
    assert set(np.diff(sweeps)) <= {every}
    assert made.posterior.sizes["draw"] == 8 * len(sweeps)
    assert 32 * len(sweeps) <= max(most, 32)  # never less than one sweep


def test_attributes_of_all_kinds(tmp_path):
    plain = {"robot": "ur10e", "name": "d\u00e9j\u00e0", "empty": "", "max_rhat": 1.004, "seed": 7, "worst": np.inf}
    as_json = {"terms": ["links", "viscous"], "pair": (1, 2.5), "sigma": np.array([1.0, 2.0]), "large": 2**70}
    as_json |= {"nothing": None, "shape": {"stribeck": [0.1]}, "path": [tmp_path]}
    write(Problem().kept(attributes={**plain, **as_json, "converged": True}), tmp_path / "p.nc")
    read = az.from_netcdf(tmp_path / "p.nc").attrs
    assert {name: read[name] for name in plain} == plain
    assert read["converged"] == 1
    expected = as_json | {"pair": [1, 2.5], "sigma": [1.0, 2.0], "path": [str(tmp_path)]}
    assert {name: json.loads(read[name]) for name in as_json} == expected
    assert (read["inference_library"], read["ensembles"], read["walkers"], read["sweeps"]) == ("bayesid", 4, 8, 40)


def _brute_force(problem, theta, log_scale, k):
    """Tempered normal densities of a segment's rows, the mean over both signs if it is unknown."""
    j = problem.normal_equations.joint[k]
    sd, power = SIGMA[j] * np.exp(log_scale[j]), 1.0 / AUTOCORRELATION[j]
    predicted, measured = problem.rows[k] @ PROJECTION @ theta, problem.effort[k]

    def log_density(sign):
        return power * np.sum(-0.5 * ((sign * measured - predicted) / sd) ** 2 - np.log(sd) - 0.5 * np.log(2 * np.pi))

    fixed = problem.target.likelihood.fixed[k]
    return log_density(fixed) if fixed else np.logaddexp(log_density(1), log_density(-1)) - np.log(2)


@pytest.mark.parametrize("own", [None, 0])
def test_pointwise_is_the_density_of_the_rows(own, rng):
    problem = Problem(own=own, fixed=(0, 7, 12))
    theta, log_scale = THETA + 0.5 * rng.standard_normal((4, 5)), 0.3 * rng.standard_normal((4, 3))
    terms = pointwise(problem.target.likelihood, problem.normal_equations, theta, log_scale)
    assert terms.shape == (4, {None: 24, 0: 3 + 2}[own])
    wanted = np.zeros_like(terms)
    for w in range(4):
        for k in range(24):
            wanted[w, problem.normal_equations.part[k]] += _brute_force(problem, theta[w], log_scale[w], k)
    assert np.allclose(terms, wanted, rtol=1e-10, atol=1e-8)


def test_a_joint_without_segments_is_accepted():
    problem, labels = Problem(), Problem().labels
    normal_equations = problem.normal_equations.chosen(np.flatnonzero(problem.normal_equations.joint != 1))
    likelihood = make_likelihood(normal_equations, labels.coefficients, SIGMA, AUTOCORRELATION, np.zeros(16, dtype=int))
    target = replace(problem.target, likelihood=likelihood)
    made = as_inference_data(keep(problem.draws(), target, one_each(normal_equations), labels, {}))
    assert np.isfinite(made.log_likelihood.effort).all()
    assert np.isnan(made.constant_data.autocorrelation.values).tolist() == [False, True, False]


def test_shared_parts_name_their_joint():
    problem = Problem(own=2, fixed=(0,))
    observed = problem.data().observed_data
    assert observed.n_blocks.sum() == 24
    assert observed.n_samples.sum() == problem.normal_equations.count.sum()
    weak = observed.sel(block="A1 4 blocks of unknown sign")
    unknown = np.setdiff1d(np.arange(0, 24, 3), (3, 9))
    members = unknown[np.argsort(-problem.normal_equations.energy[unknown])][2:]
    assert (weak.n_blocks, weak.joint, weak.fixed_sign) == (4, "A1", 0)
    assert (weak.start, weak.end) == (0.5 * members.min(), 0.5 * members.max() + 0.4)
    both = observed.sel(block="A1 2 blocks of known sign")
    assert (both.fixed_sign, both.n_unknown) == (-1, 0)
    assert np.isclose(both.effort_energy, sum(np.sum(problem.effort[k] ** 2) for k in (3, 9)))


def test_blocks_without_samples_are_left_out():
    """A segment at the end of a log, of which the filter leaves nothing: `az.loo` of ArviZ 1.x refuses it."""
    problem, last = Problem(), np.arange(24) < 23
    normal_equations = problem.normal_equations
    emptied = replace(
        normal_equations,
        hessian=normal_equations.hessian.scaled(last.astype(float)),
        gradient=normal_equations.gradient * last[:, None],
        energy=normal_equations.energy * last,
        count=normal_equations.count * last,
    )
    unknown, coefficients = np.zeros(24, dtype=np.int64), problem.labels.coefficients
    target = replace(problem.target, likelihood=make_likelihood(emptied, coefficients, SIGMA, AUTOCORRELATION, unknown))
    blocks = replace(one_each(normal_equations), normal_equations=emptied)
    made = as_inference_data(keep(problem.draws(), target, blocks, problem.labels, {}))
    assert made.log_likelihood.sizes["block"] == made.observed_data.sizes["block"] == 23
    assert (made.observed_data.n_samples > 0).all()
    assert made.log_likelihood.attrs["left_out"] == 1
    assert np.isfinite(az.loo(made, pointwise=True).pareto_k).all()


def test_blocks_at_equal_times_have_unique_names():
    problem = Problem()
    time = [np.linspace(0.0, 1.0, len(y)) for y in problem.rows]  # of 8 logs, each from zero
    problem.labels = replace(problem.labels, time=np.concatenate(time))
    names = problem.data().observed_data.block.values.tolist()
    assert len(set(names)) == 24
    assert names[:4] == ["A1 0.00-1.00 s", "A2 0.00-1.00 s", "A3 0.00-1.00 s", "A1 0.00-1.00 s (2)"]


def test_arviz_summary_and_loo_accept_the_data(data):
    table = az.summary(data, var_names=["beta", "noise"])
    assert list(table.index) == [*(f"beta[{c}]" for c in ("m1", "fv1", "Ia1")), *(f"noise[{j}]" for j in JOINTS)]
    mean, sd, rhat = (table[key].astype(float) for key in ("mean", "sd", "r_hat"))  # ArviZ 1.x rounds to text
    assert np.all(np.abs(mean.iloc[:3] - PROJECTION @ THETA) < 6 * sd.iloc[:3])
    assert np.all(rhat < 1.03)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = az.loo(data, pointwise=True)
    assert result.n_data_points == 24
    assert np.all(result.pareto_k < 0.7)
    assert 0.0 < (result.p if hasattr(result, "p") else result.p_loo) < 10.0  # of ArviZ 1.x or 0.x


def test_draws_come_back(tmp_path):
    problem = Problem()
    draws, made = problem.draws(), problem.kept()
    write(made, tmp_path / "p.nc")
    theta, noise, log_gain = read_draws(tmp_path / "p.nc", [parameter.name for parameter in problem.labels.parameters])
    assert log_gain is None
    assert np.array_equal(theta, draws.theta.transpose(1, 2, 0, 3).reshape(-1, 5))
    assert np.allclose(noise, SIGMA * np.exp(draws.log_scale.transpose(1, 2, 0, 3).reshape(-1, 3)))
    assert np.array_equal(read_coefficients(tmp_path / "p.nc"), draws.beta.transpose(1, 0, 2, 3).reshape(4, -1, 3))
    (tmp_path / "again").mkdir()
    write(made, tmp_path / "again" / "p.nc")
    assert (tmp_path / "again" / "p.nc").read_bytes() == (tmp_path / "p.nc").read_bytes()
    write(problem.kept(most=64), tmp_path / "p.nc")  # over the other one
    assert len(read_draws(tmp_path / "p.nc")[0]) == 64
    for name in made:
        with xarray.open_dataset(tmp_path / "again" / "p.nc", group=name, engine="h5netcdf") as read:
            assert read.identical(made[name].to_dataset())


def test_a_missing_or_foreign_file_is_refused(tmp_path):
    path = tmp_path / "p.nc"

    def refused(what, at=path):
        with pytest.raises(InputError, match=what):
            read_draws(at)

    refused("no such file")
    refused("no such file", tmp_path)
    for content in (b"", b"time,q1\n0,1\n"):
        path.write_bytes(content)
        refused("not a netCDF file of a posterior")
    other = xarray.Dataset({"mu": (("chain", "draw"), np.zeros((2, 10)))})
    write(xarray.DataTree.from_dict({"posterior": other}), path)
    refused("not a netCDF file of a posterior")
    pairs = {"theta": ("parameter", ["a", "b", "c"]), "noise": ("joint", ["1", "2"])}
    draws = {name: (("chain", "draw", last), np.zeros((2, 10, len(names)))) for name, (last, names) in pairs.items()}
    write(xarray.DataTree.from_dict({"posterior": xarray.Dataset(draws, dict(pairs.values()))}), path)
    refused("not written by bayesid")


def test_draws_of_another_model_or_not_finite_are_refused(tmp_path):
    made = Problem().kept()
    write(made, tmp_path / "p.nc")
    for names in (["p0", "p1"], ["p1", "p0", "p2", "p3", "p4"]):
        with pytest.raises(InputError, match="another model"):
            read_draws(tmp_path / "p.nc", names)
    made["posterior"]["noise"].values[0, 3, 1] = np.nan
    write(made, tmp_path / "p.nc")
    with pytest.raises(InputError, match="not finite"):
        read_draws(tmp_path / "p.nc")


def test_a_damaged_file_is_refused(tmp_path):
    path, rng = tmp_path / "p.nc", np.random.default_rng(2)
    write(Problem().kept(), path)
    whole, wanted = path.read_bytes(), read_draws(path)
    for share in (0.01, 0.5, 0.999):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match="damaged"):
            read_draws(path)
    for at in rng.integers(len(whole) - 16, size=20).tolist():  # somewhere that read_draws need not look at
        path.write_bytes(whole[:at] + rng.bytes(16) + whole[at + 16 :])
        with suppress(InputError):
            assert all(np.array_equal(a, b) for a, b in zip(read_draws(path), wanted, strict=True))


def test_pointwise_in_several_chunks_of_draws():
    problem, rng = Problem(), np.random.default_rng(1)
    theta, log_scale = THETA + rng.standard_normal((30_000, 5)), rng.standard_normal((30_000, 3))
    whole = pointwise(problem.target.likelihood, problem.normal_equations, theta, log_scale)
    parts = [slice(k, k + 200) for k in range(0, 30_000, 200)]
    pieces = [pointwise(problem.target.likelihood, problem.normal_equations, theta[k], log_scale[k]) for k in parts]
    assert np.allclose(whole, np.concatenate(pieces), rtol=1e-12)
