"""Design of exciting motions, and assessment of a log's motion."""
