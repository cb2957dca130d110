"""Simulated logs: trajectories, parameters, added effects, and the paper's robot."""
