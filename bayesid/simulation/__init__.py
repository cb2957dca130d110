"""Logs given parameters: trajectories, simulated logs, the paper's experiment."""
