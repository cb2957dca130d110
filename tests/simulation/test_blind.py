from dataclasses import replace
from functools import cache
from itertools import cycle

import numpy as np
import pytest
from oracles import STEP, assert_close, dh_chain, jacobian, joint_torques, random_clouds, random_motion

from bayesid.motion import Motion
from bayesid.studies import blind

ROBOTS = [(3, "kr5", "bare", False), (4, "random", "standard", False), (5, "random", "bare", True)]
LOG = slice(blind.BEFORE, None)
ALL = (*blind.EFFECTS, blind.OUTSIDE)
FRICTION = [name for name in blind.EFFECTS if name.endswith(("_friction", "_coulomb"))]
FORMS = {
    "stribeck_friction": {"full", "bump", "exponential"},
    "gravity_spring": {"sine", "two_points"},
    "hysteresis": {"stop", "maxwell_slip", "dahl", "bouc_wen"},
    "cable_drag": {"beyond", "friction", "cubic"},
    "thermal_drift": {"coulomb", "viscous", "both", "offset_fading", "offset_growing"},
    "dead_zone": {"reads_zero", "shrunk"},
    blind.OUTSIDE: set(blind.OUTSIDE_FORMS),
}


@cache
def healthy(seed, robot, style, slow):
    return blind.simulate(seed, None, 0.0, robot, style, slow)


@cache
def hiding(effect, seed, robot, style, slow, size):
    return blind.simulate(seed, effect, size, robot, style, slow)


@cache
def scene(robot="kr5", slow=False, seed=11):
    return blind.simulate(seed, None, 0.0, robot, "standard", slow).plays[1]


def drafts(effect, play, seeds=60):
    """Many draws of an effect, the joint given away with each."""
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        yield blind.DRAFTS[effect](rng, play, seed % play.robot.n)


def torque(draft, play, magnitude=1.0):
    return (draft.act(play, play.healthy(), magnitude) - play.healthy())[:, draft.joint or 0]


def forms(effect, play):
    """One draft of each form of an effect."""
    found = {draft.parameters.get("form"): draft for draft in drafts(effect, play)}
    assert set(found) == FORMS.get(effect, {None})
    return found


def body_of(points, masses):
    centre = masses @ points / masses.sum()
    r = points - centre
    return blind.Body(masses.sum(), centre, masses.sum() * spread(r, masses / masses.sum()))


def spread(r, shares):
    return shares @ np.sum(r**2, axis=1) * np.eye(3) - (r * shares[:, None]).T @ r


def robot_of(kind, seed):
    """A robot whose links are clouds of points, and the clouds."""
    robot = blind.bare_robot(np.random.default_rng(seed), kind)
    clouds = random_clouds(robot.n, seed)
    return replace(robot, links=tuple(body_of(*cloud) for cloud in clouds)), clouds


@pytest.mark.parametrize(("kind", "seed"), [("kr5", 0), *(("random", seed) for seed in range(2))])
def test_rigid_efforts_obey_virtual_work(kind, seed):
    robot, clouds = robot_of(kind, seed)
    motion = random_motion(robot.n, 4, seed)
    expected = joint_torques(dh_chain(robot.table), clouds, robot.table["gravity"], motion)
    assert_close(robot.rigid_efforts(motion.q, motion.dq, motion.ddq), expected, 1e-10)


def test_trouble_leaves_the_told_table_and_the_motion_alone():
    """The table that is told, the motions are those of the case without trouble."""
    plain = blind.simulate(3, None, 0.0, "kr5", "standard")
    troubled = blind.simulate(3, None, 0.0, "kr5", "standard", trouble=blind.Trouble(0.005, 0.01, 0.9))
    assert troubled.table == plain.table == plain.robot.table
    assert troubled.robot.table != plain.table
    np.testing.assert_array_equal(troubled.log.q, plain.log.q)
    noise = troubled.log.measured - troubled.log.clean
    lasting = np.mean(noise[1:] * noise[:-1], axis=0) / np.mean(noise**2, axis=0)
    np.testing.assert_allclose(lasting, 0.9, atol=0.05)
    np.testing.assert_allclose(np.sqrt(np.mean(noise**2, axis=0)), troubled.noise, rtol=0.25)
    gap = np.sqrt(np.mean((troubled.log.clean - plain.log.clean) ** 2, axis=0) / np.mean(plain.log.clean**2, axis=0))
    assert np.all((gap > 0.0) & (gap < 1.0))


def test_speeds_and_accelerations_are_derivatives():
    series = blind.random_series(np.random.default_rng(2), 5, True)
    t = blind.times()
    q, dq, ddq = series(t)
    later = series(t + 1j * STEP)
    assert_close(dq, later[0].imag / STEP, 1e-12)
    assert_close(ddq, later[1].imag / STEP, 1e-12)


@pytest.mark.parametrize(("effect", "setup"), list(zip(ALL, cycle(ROBOTS))), ids=ALL)
def test_effect_has_the_size_asked_for(effect, setup):
    seed, robot, style, slow = setup
    size = {"kr5": 2.0, "random": 7.0 if slow else 0.6}[robot]
    case = hiding(effect, *setup, size)
    without = healthy(seed, robot, style, slow or effect == "stribeck_friction")
    np.testing.assert_array_equal(case.log.q, without.log.q)
    difference = case.log.clean - without.log.clean
    ratios = blind.rms(difference) / case.noise
    assert ratios.max() == pytest.approx(size, rel=0.02)
    joint = case.hidden[0].draft.joint
    if joint is None:
        assert effect in ("payload", "base_tilt", "tool_wrench", "delay")
        assert np.count_nonzero(ratios) > 1
    else:
        assert np.flatnonzero(ratios).tolist() == [joint]
    shown = np.max(blind.rms(case.holdout.clean - without.holdout.clean) / case.noise)
    assert shown == pytest.approx(case.hidden[0].holdout_size)
    assert shown > 0.3 * size


@pytest.mark.parametrize("seed", range(3))
def test_each_of_two_effects_has_the_size_asked_for(seed):
    rng = np.random.default_rng(seed)
    names = tuple(rng.choice(blind.EFFECTS, 2, replace=False).tolist())
    case = blind.simulate(seed, names, 5.0)
    assert {h.name for h in case.hidden} == set(names)
    play, efforts = case.plays[1], case.plays[1].healthy()
    for hidden in case.hidden:
        after = hidden.act(play, efforts)
        assert blind.ratio_of(after, efforts, case.noise) == pytest.approx(5.0, rel=0.02)
        efforts = after
    np.testing.assert_array_equal(case.log.clean, efforts[LOG])


def test_friction_opposes_the_motion():
    play = scene("random", True)
    for effect in FRICTION:
        for draft in forms(effect, play).values():
            power = torque(draft, play) * play.dq[:, draft.joint]
            assert power.min() >= 0
            assert power.max() > 0
    play = scene()
    for effect, names in (("cable_drag", {"friction"}), ("thermal_drift", {"coulomb", "viscous", "both"})):
        for form, draft in forms(effect, play).items():
            power = torque(draft, play) * play.dq[:, draft.joint]
            assert (power.min() >= 0) == (form in names)


def test_spring_between_two_points_is_the_slope_of_its_energy():
    play = scene()
    draft = forms("gravity_spring", play)["two_points"]
    x = draft.parameters
    later = play.q[:, draft.joint] + 1j * STEP - x["rest"]
    ends = x["far"] * np.ones_like(later), 0j * later
    distance = np.sqrt((ends[0] - x["near"] * np.cos(later)) ** 2 + (ends[1] - x["near"] * np.sin(later)) ** 2)
    energy = 0.5 * (distance - x["free_length"]) ** 2
    assert_close(torque(draft, play), energy.imag / STEP, 1e-10)
    assert 0 < x["free_length"] < distance.real.min()


def test_held_mass_pulls_down():
    play = scene("random")
    draft = next(drafts("payload", play))
    mass, centre = 2.5, np.array(draft.parameters["centre"])
    inertia = np.array(draft.parameters["inertia_per_mass"])
    body = blind.Body(mass, centre, mass * inertia)
    expected = play.robot.loaded(body).rigid_efforts(play.q, play.dq, play.ddq) - play.rigid
    assert_close(draft.act(play, play.healthy(), mass) - play.healthy(), expected, 1e-9)
    clouds = [(np.zeros((1, 3)), np.zeros(1))] * (play.robot.n - 1) + [(centre[None], np.ones(1))]
    q, none = play.q[300:301], np.zeros((1, play.robot.n))
    held = joint_torques(dh_chain(play.robot.table), clouds, blind.GRAVITY, Motion([0.0], q, none, none))
    unit = play.robot.loaded(blind.Body(1.0, centre, inertia))
    assert_close(unit.rigid_efforts(q, none, none) - play.robot.rigid_efforts(q, none, none), held, 1e-9)


def test_tilted_base_turns_gravity():
    play = scene("random")
    draft = next(drafts("base_tilt", play))
    angle, heading = 0.03, draft.parameters["heading"]
    slope = 9.81 * np.sin(angle) * np.array([-np.sin(heading), np.cos(heading), 0.0])
    turned = slope - [0.0, 0.0, 9.81 * np.cos(angle)]
    tilted = replace(play.robot, table=play.robot.table | {"gravity": turned.tolist()})
    expected = tilted.rigid_efforts(play.q, play.dq, play.ddq) - play.rigid
    found = draft.act(play, play.healthy(), angle) - play.healthy()
    assert_close(found, expected, 1e-9)
    mirrored = draft.act(play, play.healthy(), -angle) - play.healthy()
    assert np.abs(found - mirrored).max() > np.abs(found).max()


def wrench_torques(play, parameters, k):
    """Efforts that hold force and torque on the flange by virtual work; the torque is a couple of forces."""
    chain, q = dh_chain(play.robot.table), play.q[k]
    flange = chain(q)[0][-1]
    turn = flange[:3, :3] if parameters["frame"] == "tool" else np.eye(3)
    force, moment = turn @ parameters["force"], turn @ parameters["torque_per_force"]
    across = np.cross(moment, [0.3, -0.5, 0.8])
    across = across / np.linalg.norm(across) if moment.any() else np.array([1.0, 0.0, 0.0])
    arm = flange[:3, :3].T @ np.cross(across, moment) / 2
    clouds = [(np.zeros((0, 3)), np.zeros(0))] * (len(q) - 1) + [(np.array([0 * arm, arm, -arm]), np.ones(3))]
    at_flange, one, other = jacobian(chain, clouds, q)
    return -(at_flange.T @ force + one.T @ across - other.T @ across)


def test_wrench_on_the_tool_obeys_virtual_work():
    play, seen = scene("random"), set()
    for draft in drafts("tool_wrench", play, 12):
        seen.add((draft.parameters["frame"], any(draft.parameters["torque_per_force"])))
        found = draft.act(play, play.healthy(), 1.0) - play.healthy()
        for k in (0, 700, 1900):
            np.testing.assert_allclose(found[k], wrench_torques(play, draft.parameters, k), atol=1e-9)
    assert len(seen) == 4


def test_readings_are_scaled_late_or_clipped():
    play = scene()
    healthy = play.healthy()
    for draft in drafts("gain_error", play, 3):
        share = draft.act(play, healthy, 0.2)[:, draft.joint] / healthy[:, draft.joint]
        np.testing.assert_allclose(share, 1 + 0.2 * draft.parameters["sign"])
    for draft in drafts("delay", play, 8):
        columns = slice(None) if draft.joint is None else [draft.joint]
        late = draft.act(play, healthy, 0.07)[LOG, columns]
        np.testing.assert_allclose(late, healthy[blind.BEFORE - 7 : -7, columns], atol=1e-8)
    draft = next(drafts("clipping", play))
    whole = healthy[:, draft.joint]
    limit = 0.5 * np.abs(whole[LOG]).max()
    clipped = draft.act(play, healthy, draft.parameters["peak"] - limit)[:, draft.joint]
    np.testing.assert_allclose(clipped, np.clip(whole, -limit, limit))


def test_dead_zone_swallows_small_efforts():
    play = scene()
    for form, draft in forms("dead_zone", play).items():
        whole = play.healthy()[:, draft.joint]
        width = 0.3 * np.abs(whole).max()
        left = draft.act(play, play.healthy(), width)[:, draft.joint]
        small = np.abs(whole) < width
        assert 0 < small.mean() < 1
        assert np.all(left[small] == 0)
        expected = whole[~small] - (width * np.sign(whole[~small]) if form == "shrunk" else 0.0)
        np.testing.assert_allclose(left[~small], expected)


def test_what_is_outside_the_catalogue_is_not_explained_by_it():
    for kind in ("kr5", "random"):
        play = scene(kind)
        for form, draft in forms(blind.OUTSIDE, play).items():
            j, found = draft.joint, torque(draft, play)[LOG]
            q, dq, ddq, load = (x[LOG, j] for x in (play.q, play.dq, play.ddq, play.rigid))
            s = np.sign(dq)
            columns = [q**0, q, q**3, dq, ddq, s, np.abs(s), np.abs(load) * s, np.sin(q), np.cos(q), np.abs(q) * s]
            basis = np.column_stack([*columns, play.weights[LOG, j]])
            rest = found - basis @ np.linalg.lstsq(basis, found, rcond=None)[0]
            assert blind.rms(rest) > 0.3 * blind.rms(found), form
