"""What passes between the parts: events and windows, readings of a gyro, estimates, options."""
