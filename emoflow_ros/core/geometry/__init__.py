"""Cameras, their calibration, and the motion field that a moving one sees."""
