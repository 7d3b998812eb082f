"""Recordings, replay, evaluation, metrics and reports."""
