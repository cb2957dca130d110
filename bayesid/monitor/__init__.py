"""Tracking of a running robot: signs, external torques, contacts and changes, sample by sample."""
