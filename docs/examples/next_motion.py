"""The motion to record next on a Yaskawa GP7 after a short log, and what it will determine."""

import matplotlib.pyplot as plt
import numpy as np

import bayesid

robot = bayesid.load_robot("gp7")
motion = bayesid.random_trajectory(6, duration=4.0, rng=5).motion(np.arange(401) / 100.0)
model = bayesid.Model.of(robot, ["rigid_body", "viscous_friction", "coulomb_friction"], motion)
rng = np.random.default_rng(5)
log = bayesid.simulate(model, bayesid.random_parameters(model, rng=rng), motion, rng=rng, noise=0.1)

result = bayesid.identify(robot, log, posterior=False)
design = bayesid.design_excitation(result, settings=bayesid.MotionSettings(duration=8.0, changes=600))
open_now, other, designed = design.predicted.open_now, design.of_random.open, design.predicted.open
t = np.linspace(0.0, 8.0, 401)
left, right = plt.figure(figsize=(8.0, 3.0), layout="constrained").subplots(1, 2)
left.plot(t, design.trajectory.motion(t).q, label=[f"joint {joint}" for joint in range(1, 7)])
left.set(xlabel="time, s", ylabel="designed motion, rad", ylim=(-3.0, 2.2))
left.legend(ncols=3, fontsize="x-small")
right.bar(["first log", "with a\nrandom motion", "with the\ndesigned one"], [open_now, other, designed], 0.5)
right.set(ylabel="coefficients not known to 10 %")
left.figure.savefig("next_motion.png", dpi=80)
