"""Numerics that know nothing of cameras: compilation, smoothing, band matrices."""
