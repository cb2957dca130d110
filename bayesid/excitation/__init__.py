"""Motions that show coefficients and signs, and what a log's motion leaves undecided."""
