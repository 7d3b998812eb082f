"""Positions to motion: poses, velocities and inverse depths adjusted over the last slices."""
