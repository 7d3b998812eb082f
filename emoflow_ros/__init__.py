"""Camera egomotion and dense optical flow from event cameras by test-time optimisation."""

__version__ = "0.2.0"
