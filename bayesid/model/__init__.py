"""What a robot is: kinematics, the effects that make its efforts, and the coefficients they show."""
