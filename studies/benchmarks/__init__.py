"""Benchmarks: scripts that print what something costs, and beside what else."""
