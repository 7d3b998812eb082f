"""Synthetic recordings with exact ground truth: scenes, sensors, and the files they write.

Named scenes are in `recording`, random ones in `random_recording`.
"""
