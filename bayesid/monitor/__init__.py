"""What changes while the robot runs: signs, torques, contacts and changes, sample by sample."""
