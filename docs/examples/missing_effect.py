"""What a model lacks: a spring in joint 2 of a Franka Panda, added after the model was identified."""

import matplotlib.pyplot as plt
import numpy as np

import bayesid
from bayesid.effects.springs import JointSpring

robot, rng = bayesid.load_robot("panda"), np.random.default_rng(3)
first, second = (bayesid.random_trajectory(7, 12.0, rng=seed).motion(np.arange(961) / 80.0) for seed in (1, 2))
model = bayesid.Model.of(robot, ["rigid_body", "viscous_friction", "coulomb_friction"], first)
truth = bayesid.random_parameters(model, rng=rng)
changed, spring = model.extend(JointSpring(joints=(2,))), [6.0, 2.0]  # N m/rad, N m
before = bayesid.simulate(model, truth, first, rng=rng, noise=0.03)
after = bayesid.simulate(changed, np.append(truth, spring), second, rng=rng, noise=0.03)

result = bayesid.identify(robot, before, posterior=False)
found = bayesid.find_discrepancy(result, after, posterior=False)
print(found.status, [(effect.effect, effect.joints) for effect in found.added])
axis = plt.figure(figsize=(8.0, 3.0), layout="constrained").gca()
for shift, label, gap in ((-0.2, "model before", found.before), (0.2, "with the spring found", found.after)):
    axis.bar(np.arange(1, 8) + shift, gap / found.floor.rms, 0.4, label=label)
axis.set(xlabel="joint", ylabel="RMS error / noise floor")
axis.legend()
axis.figure.savefig("missing_effect.png", dpi=80)
