"""The posterior: what the data and a stated prior say about parameters, noise and signs together."""
