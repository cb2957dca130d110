"""Discrepancy of a model and a log: missing effects, and changes over several logs."""
