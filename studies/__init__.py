"""Studies: pure functions from a scenario to a dict, mapped by one runner. Run one with `python -m studies.NAME`."""
