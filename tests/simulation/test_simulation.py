from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy import stats

from bayesid.effects import STANDARD, RigidBody, TorqueOffset, ViscousFriction
from bayesid.effects.catalogue import main_forms, make_terms
from bayesid.effects.distortion import RobotDistortion
from bayesid.effects.drive import FASTEST_HARMONIC
from bayesid.effects.model import Model
from bayesid.errors import InputError
from bayesid.motion import Motion
from bayesid.posterior.sampler import Sampling
from bayesid.robot import Joint, Robot, load_robot
from bayesid.simulation import logs as simulation
from bayesid.simulation.logs import SimulatedEffect, parse_effect, simulate, simulate_log
from bayesid.simulation.paper import nominal_parameters, paper_model
from bayesid.simulation.parameters import random_parameters
from bayesid.simulation.trajectories import HARMONICS, random_trajectory

pytestmark = pytest.mark.usefixtures("any_motion")

ROBOTS = ("kr5", "ur10e", "panda", "tx40")


def motion_of(n_joints, samples=667, seed=7):
    return random_trajectory(n_joints, 13.33, rng=seed).motion(np.linspace(0, 13.33, samples))


def default_model(name):
    robot = load_robot(name)
    return Model(robot, make_terms(STANDARD, robot, motion_of(robot.n_joints, 100)))


def rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


def test_without_noise_the_efforts_are_newton_and_euler():
    model, motion = paper_model(), motion_of(6)
    log = simulate(model, nominal_parameters(), motion, rng=np.random.default_rng(0), noise=0.0, signed=True)
    np.testing.assert_allclose(log.effort, model.robot.inverse_dynamics(motion, nominal_parameters()), atol=1e-9)
    np.testing.assert_array_equal(log.q, motion.q)
    np.testing.assert_array_equal(log.t, motion.t)
    assert log.signed.all()


def test_noise_is_white_gaussian_with_the_stated_deviation():
    model, motion, noise = paper_model(), motion_of(6, 4000), 0.3
    clean = model.effort(motion, nominal_parameters())
    log = simulate(model, nominal_parameters(), motion, rng=np.random.default_rng(11), noise=noise, signed=True)
    z = (log.effort - clean) / (noise * rms(clean))
    lowest, highest = stats.chi2.ppf([1e-4, 1 - 1e-4], len(z))
    assert np.all(((z**2).sum(axis=0) > lowest) & ((z**2).sum(axis=0) < highest))
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(len(z))
    assert np.abs((z[1:] * z[:-1]).mean(axis=0)).max() < 4.5 / np.sqrt(len(z))
    assert np.abs(np.corrcoef(z.T) - np.eye(6)).max() < 4.5 / np.sqrt(len(z))
    assert min(stats.kstest(column, "norm").pvalue for column in z.T) > 1e-4


def test_coloured_noise_has_the_stated_deviation_and_correlation():
    """AR(1): variance as in the white case from the first sample on, correlation colour^k at lag k."""
    model, motion, colour = paper_model(), motion_of(6, 20_000), 0.9
    clean = model.effort(motion, nominal_parameters())
    log = simulate(
        model, nominal_parameters(), motion, rng=np.random.default_rng(12), noise=0.2, colour=colour, signed=True
    )
    z = (log.effort - clean) / (0.2 * rms(clean))
    count = len(z) * (1.0 - colour**2) / (1.0 + colour**2)  # what the squares of an AR(1) process are worth (Bartlett)
    assert np.abs((z**2).mean(axis=0) - 1.0).max() < 4.5 * np.sqrt(2.0 / count)
    for lag in (1, 2, 5):
        expected = colour**lag
        found = (z[lag:] * z[:-lag]).mean(axis=0) / (z**2).mean(axis=0)
        assert np.abs(found - expected).max() < 4.5 / np.sqrt(count)
    innovation = z[1:] - colour * z[:-1]
    assert np.abs((innovation[1:] * innovation[:-1]).mean(axis=0)).max() < 4.5 * (1.0 - colour**2) / np.sqrt(len(z))


def test_invalid_noise_is_refused():
    sensors = (np.full(6, -0.1), np.full(6, np.nan), np.full(5, 0.1), np.full((6, 1), 0.1))
    for option, said, values in (
        ("colour", "correlation", (1.0, -0.1, np.nan)),
        ("noise", "noise", (-0.1, np.nan, np.inf)),
        ("sensor", "sensor", sensors),
    ):
        for value in values:
            with pytest.raises(ValueError, match=said):
                simulate(
                    paper_model(), nominal_parameters(), motion_of(6), rng=np.random.default_rng(1), **{option: value}
                )


def test_an_unsigned_log_is_the_absolute_value_of_the_signed_one():
    """For all joints, or some; another generator gives another log."""
    model, motion, some = paper_model(), motion_of(6), np.array([True, False, True, False, False, True])
    signed, unsigned, both, other = (
        simulate(model, nominal_parameters(), motion, rng=np.random.default_rng(seed), noise=0.2, signed=keep)
        for seed, keep in ((4, True), (4, False), (4, tuple(some)), (5, True))
    )
    np.testing.assert_array_equal(unsigned.effort, np.abs(signed.effort))
    np.testing.assert_array_equal(both.effort, np.where(some, signed.effort, unsigned.effort))
    np.testing.assert_array_equal(both.signed, some)
    assert not unsigned.signed.any()
    assert np.any(signed.effort < 0.0, axis=0).all()
    assert np.all(np.mean(signed.effort == other.effort, axis=0) < 0.01)


def test_a_sensor_is_as_noisy_in_any_motion():
    """N m of each joint, whatever its efforts: 6670 samples know a standard deviation to 0.9 %."""
    model, sensor = paper_model(), np.array([3.0, 0.4, 1.2, 0.02, 0.3, 0.0])
    for share in (1.0, 0.1):
        fast = motion_of(6, 6670)
        motion = Motion(fast.t, fast.q, share * fast.dq, share**2 * fast.ddq)
        log = simulate(
            model, nominal_parameters(), motion, rng=np.random.default_rng(6), noise=0.3, signed=True, sensor=sensor
        )
        left = log.effort - model.effort(motion, nominal_parameters())
        np.testing.assert_allclose(left.std(axis=0), sensor, rtol=0.05)
        assert np.abs(left[:, 5]).max() == 0.0


@pytest.mark.parametrize("name", ROBOTS)
def test_random_parameters_are_those_of_a_plausible_robot(name):
    """Strictly inside the cone; links get lighter towards the tip; other effects are a share of the joint's torque."""
    model = default_model(name)
    n = model.robot.n_joints
    for seed in range(10):
        theta = random_parameters(model, rng=np.random.default_rng(seed))
        assert np.all(theta[model.cone.nonnegative] > 0.0)
        assert np.all(model.cone.smallest_eigenvalues(theta) > 1e-5)
        masses = theta[: 10 * n].reshape(-1, 10)[:, 9]
        assert np.all(np.diff(masses) < 0.0)
        assert 5.0 < masses.sum() < 80.0
    rng = np.random.default_rng(60)
    arrays = {key: rng.uniform(-limit, limit, (2000, n)) for key, limit in (("q", 2.0), ("dq", 2.0), ("ddq", 5.0))}
    columns, size = model.columns(Motion(np.arange(2000.0), **arrays)), 10 * n
    rigid = rms(columns[:, :, :size] @ theta[:size])
    for k, term in enumerate(model.terms[1:]):
        part = slice(size + k * n, size + (k + 1) * n)
        share = rms(columns[:, :, part] @ theta[part]) / rigid
        low, high = (0.01, 0.05) if term.name == "torque_offset" else (0.05, 0.25)
        assert np.all((share > 0.85 * low) & (share < 1.15 * high))


def test_a_model_without_bodies_and_a_model_of_one_joint():
    """Offsets are of either sign."""
    model = Model(load_robot("kr5"), (ViscousFriction(), TorqueOffset()))
    friction = np.array([random_parameters(model, rng=np.random.default_rng(seed)) for seed in range(20)])
    assert np.all(friction[:, :6] > 0.0)
    assert np.all(np.any(friction[:, 6:] < 0, axis=0) & np.any(friction[:, 6:] > 0, axis=0))
    pendulum = Robot("pendulum", (Joint(np.eye(4), np.array([0.0, 1.0, 0.0])),), np.array([0.0, 0.0, -9.81]))
    model = Model(pendulum, (RigidBody(), ViscousFriction()))
    theta = random_parameters(model, rng=np.random.default_rng(1))
    assert model.cone.smallest_eigenvalues(theta)[0] > 0.0
    assert theta[10] > 0.0


NAMES = tuple(main_forms())
OF_ALL = tuple(name for name, kind in main_forms().items() if kind.acts_on == "robot")
OF_ROBOT = {name for name, kind in main_forms().items() if issubclass(kind, RobotDistortion) and name not in OF_ALL}
"""Of a joint and those before it."""
AT = {"link_length": 3, "link_twist": 4, "joint_zero": 2, "gear_ratio": 3}
"""The joint in which a table can be as far off as here."""


@cache
def efforts(*effects, robot="kr5", seed=3, noise=0.0, rate=50.0):
    """Signed efforts with effects of the command line."""
    robot = load_robot(robot)
    chosen = [parse_effect(text, robot) for text in effects]
    unsigned, signed = simulate_log(robot, 12.0, rate, noise, chosen, seed)
    np.testing.assert_array_equal(unsigned.effort, np.abs(signed.effort))
    np.testing.assert_array_equal(unsigned.q, signed.q)
    assert not unsigned.signed.any()
    assert signed.signed.all()
    signed.effort.setflags(write=False)
    return signed.effort


@pytest.mark.parametrize("name", [name for name in NAMES if name not in OF_ROBOT or name in AT])
def test_an_effect_has_its_level_on_its_joint(name):
    for joint, level in ((AT[name], 0.05),) if name in AT else ((2, 0.3), (5, 0.05)):
        healthy = efforts()
        change = efforts(f"{name}:{joint}:{level}") - healthy
        assert rms(change)[joint - 1] == pytest.approx(level * rms(healthy)[joint - 1], rel=0.01)
        others = np.delete(np.abs(change).max(axis=0), joint - 1)
        if name != "delay" and name not in OF_ROBOT:  # of one joint or of all
            assert others.any() == (name in OF_ALL)


def test_friction_springs_and_bodies_are_physical():
    """What cannot be negative is positive: dissipation, stiffness, mass; a lag is not a lead."""
    robot = load_robot("kr5")
    for name, seed in product((name for name in NAMES if name not in OF_ROBOT), range(2)):
        theta, motion = nominal_parameters(), random_trajectory(6, 12.0, rng=seed).motion(np.arange(601) / 50)
        model = Model(robot, (RigidBody(),))
        model, theta = simulation.with_effects(model, theta, motion, [SimulatedEffect(name, 4, 0.1)], seed)
        assert np.all(theta[model.cone.nonnegative] > 0.0)
        if name == "payload":
            assert model.cone.smallest_eigenvalues(theta)[-1] > 0.0
            mass, moment = theta[-1], theta[-4:-1]
            assert mass > 0.0
            assert np.linalg.norm(moment) < 0.25 * mass
        elif name == "delay":
            assert 0.0 < model.distortions[0].lag[0] < 0.5
        elif name == "base_tilt":
            assert 0.0 < np.hypot(*model.distortions[0].angle) <= 1.0


def test_distortions_apply_after_terms_and_sensors_last():
    """In any order of the effects."""
    rough = efforts("coulomb_friction:2:0.5")[:, 1]
    for texts in (("gain_error:2:0.2", "coulomb_friction:2:0.5"), ("coulomb_friction:2:0.5", "gain_error:2:0.2")):
        gain = efforts(*texts)[:, 1] / rough
        np.testing.assert_allclose(gain, gain[0], rtol=1e-9)
        assert abs(gain[0] - 1.0) == pytest.approx(0.2, rel=1e-4)
        for several in (("clipping:2:0.05", *texts), (*texts, "clipping:2:0.05")):
            clipped = efforts(*several)[:, 1]
            limit = np.abs(clipped).max()
            gain = np.median(clipped / rough)
            np.testing.assert_allclose(clipped, np.clip(gain * rough, -limit, limit), rtol=1e-9)
            assert abs(gain - 1.0) == pytest.approx(0.2, rel=1e-4)
            assert rms(clipped - gain * rough) == pytest.approx(0.05 * rms(gain * rough), rel=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_sensors_read_the_noise_as_well(noise):
    healthy = efforts(noise=noise, rate=200.0)
    clipped = efforts("clipping:2:0.1", noise=noise, rate=200.0)
    limit = np.abs(clipped[:, 1]).max()
    np.testing.assert_array_equal(clipped[:, 1], np.clip(healthy[:, 1], -limit, limit))
    assert (np.abs(clipped[:, 1]) == limit).sum() > 20
    blind = efforts("dead_zone:1:0.1", noise=noise, rate=200.0)
    width = np.abs(blind[blind[:, 0] != 0.0, 0]).min()
    np.testing.assert_array_equal(blind[:, 0], np.where(np.abs(healthy[:, 0]) < width, 0.0, healthy[:, 0]))
    assert (blind[:, 0] == 0.0).sum() > 20


def test_a_level_of_zero_is_no_effect():
    for name in ("viscous_friction", "payload", "delay", "clipping"):
        np.testing.assert_array_equal(efforts(f"{name}:6:0", noise=0.1), efforts(noise=0.1))


def test_levels_out_of_reach_are_refused():
    assert FASTEST_HARMONIC == HARMONICS, "lags go as far as motions"
    few = "dead_zone:2:0.001"  # so few efforts are so small that one sample more makes a difference
    of_flange, light = "tool_wrench:6:1", "base_tilt:6:100"  # the force acts on the last axis; the wrist is light
    for text in ("delay:2:5", "base_tilt:4:0.3", light, "clipping:3:1.5", "dead_zone:3:1.2", of_flange, few):
        with pytest.raises(InputError, match="cannot be simulated") as refusal:
            efforts(text)
        assert repr(text) in str(refusal.value)
        assert refusal.value.field == "effects"
        assert "\n" not in str(refusal.value)


def test_invalid_effects_are_refused():
    names = ("rigid_body:1:0.1", "hysteresis.smooth:1:0.1", "dead_zone.shrinking:1:0.1", "friction:1:0.1", "")
    joints = ("payload:7:0.1", "payload:0:0.1", "payload:one:0.1")
    levels = ("payload:1:-0.1", "payload:1:1e4", "payload:1:nan", "payload:1:much")
    for text in (*names, *joints, *levels, "payload", "payload:1", "payload:1:0.1:2"):
        says = {"payload:7:0.1": "give 1 to 6", "payload:0:0.1": "give 1 to 6"}.get(text, "give 0 to 1000")
        with pytest.raises(InputError) as refusal:
            parse_effect(text, load_robot("kr5"))
        assert repr(text) in str(refusal.value)
        assert "\n" not in str(refusal.value)
        assert refusal.value.remedy == says or all(name in refusal.value.remedy for name in NAMES)


def test_rng_is_a_seed_a_generator_or_none():
    """A generator goes on from where it is; None is another one each time."""

    def drawn(rng):
        return random_trajectory(3, 4.0, rng=rng).sine

    np.testing.assert_array_equal(drawn(5), drawn(np.random.default_rng(5)))
    going_on = np.random.default_rng(5)
    assert not np.array_equal(drawn(going_on), drawn(going_on))
    assert not np.array_equal(drawn(None), drawn(None))
    assert Sampling(rng=np.int64(7)).seed == Sampling(rng=7).seed == 7
    assert Sampling(rng=np.random.default_rng(1)) == Sampling(rng=np.random.default_rng(1)) != Sampling(rng=1)
