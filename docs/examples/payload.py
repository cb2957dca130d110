"""Payloads of 1, 2 and 4 kg on a Staubli TX60, weighed from |torque|."""

import matplotlib.pyplot as plt
import numpy as np

import bayesid

robot, rng = bayesid.load_robot("tx60"), np.random.default_rng(4)
motions = [bayesid.random_trajectory(6, 12.0, rng=seed).motion(np.arange(961) / 80.0) for seed in range(4)]
model = bayesid.Model.of(robot, ["rigid_body", "viscous_friction", "coulomb_friction"], motions[0])
truth = bayesid.random_parameters(model, rng=rng)
result = bayesid.identify(robot, bayesid.simulate(model, truth, motions[0], rng=rng, noise=0.05))

one_kg = np.array([0.012, 0.0, 0.0, 0.012, 0.0, 0.002, 0.0, 0.0, 0.1, 1.0])  # 0.1 m from the flange along its z
axis = plt.figure(figsize=(5.0, 3.0), layout="constrained").gca()
axis.axhline(0.0, color="black", lw=0.8)
for mass, motion in zip((1.0, 2.0, 4.0), motions[1:], strict=True):
    loaded = truth.copy()
    loaded[model.cone.bodies[-1]] += mass * one_kg
    log = bayesid.simulate(model, loaded, motion, rng=rng, noise=0.05)
    found = bayesid.identify_payload(result, log, common_sd=0.0).body.mass  # the torque scale is exact
    error, (low, high) = found.value - mass, np.abs(np.array(found.interval) - found.value)
    axis.errorbar(f"{mass:g} kg", 1e3 * error, [[1e3 * low], [1e3 * high]], fmt="C0o", capsize=4)
axis.set(xlabel="payload", ylabel="error of the mass, g")
axis.figure.savefig("payload.png", dpi=80)
