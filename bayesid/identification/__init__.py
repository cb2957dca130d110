"""The pipeline: from a log to signs, coefficients and parameters, and the identified model."""
