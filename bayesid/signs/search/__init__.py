"""Searches for the signs of the segments."""
