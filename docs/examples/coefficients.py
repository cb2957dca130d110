"""Friction of a Universal Robots UR10e from |torque|, with 95 % intervals, relative to the true values."""

import matplotlib.pyplot as plt
import numpy as np

import bayesid

robot = bayesid.load_robot("ur10e")
motion = bayesid.random_trajectory(6, duration=10.0, rng=2).motion(np.arange(1001) / 100.0)
model = bayesid.Model.of(robot, ["rigid_body", "viscous_friction", "coulomb_friction"], motion)
rng = np.random.default_rng(2)
truth = bayesid.random_parameters(model, rng=rng)
log = bayesid.simulate(model, truth, motion, rng=rng, noise=0.1)

result = bayesid.identify(robot, log)
true = dict(zip((parameter.name for parameter in model.parameters), truth, strict=True))
axis = plt.figure(figsize=(8.0, 3.0), layout="constrained").gca()
axis.axhline(1.0, color="black", lw=0.8)
for name in (f"{kind}{joint}" for kind in ("Fv", "Fc") for joint in range(1, 7)):
    found = result.coefficient(name)
    low, mean, high = np.array([found.lower, found.mean, found.upper]) / true[name]
    axis.errorbar(name, mean, [[mean - low], [high - mean]], fmt="C0o", capsize=4)
axis.set_ylabel("estimate / true value")
axis.figure.savefig("coefficients.png", dpi=80)
