"""Parameters given signs: moments of a log, least squares in the cone, noise, and what is known beforehand."""
