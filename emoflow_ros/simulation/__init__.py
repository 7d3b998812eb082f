"""Synthetic recordings with exact ground truth: scenes, sensors, and the files they write.

The command is in `simulate`, the named scenes in `recording`, random ones in `random_recording`.
"""
