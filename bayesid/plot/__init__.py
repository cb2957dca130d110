"""Figures of results, as matplotlib Axes: see `bayesid.plot.torques` and its like. Only here matplotlib is imported."""
