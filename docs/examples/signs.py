"""Signs of a FANUC LR Mate whose log holds |torque| only: found, and compared with the true ones."""

import numpy as np

import bayesid

robot = bayesid.load_robot("lrmate200id")
motion = bayesid.random_trajectory(6, duration=10.0, rng=1).motion(np.arange(1001) / 100.0)
model = bayesid.Model.of(robot, ["rigid_body", "viscous_friction", "coulomb_friction"], motion)
rng = np.random.default_rng(1)
truth = bayesid.random_parameters(model, rng=rng)
log = bayesid.simulate(model, truth, motion, rng=rng, noise=0.05)  # absolute values

result = bayesid.identify(robot, log, posterior=False)
right = result.sample_signs == np.sign(model.effort(motion, truth))
print(f"proven: {result.search.certified}; right: {right.mean():.1%} of all samples")
axes = bayesid.plot.torques(result, joints=[2, 5])
axes[0].figure.savefig("signs.png", dpi=80, facecolor="white")
