"""Synthetic recordings with exact ground truth."""
