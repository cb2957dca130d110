"""Recorded logs: reading, filtering and segments of constant sign."""
