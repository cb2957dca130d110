"""Benchmarks: scripts that print times, memory and comparisons with other methods."""
