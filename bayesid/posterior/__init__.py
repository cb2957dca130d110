"""The posterior of parameters, noise and signs, given data and prior."""
