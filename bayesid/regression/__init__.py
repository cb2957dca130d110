"""Parameters given signs: normal equations of a log, least squares in the cone, noise, and priors."""
