"""Robot dynamics identification when the controller hides the sign of the motor currents."""
