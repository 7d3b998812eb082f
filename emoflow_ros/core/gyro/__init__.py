"""A gyro beside the camera: what it measures, its bias, its clock and its faults."""
