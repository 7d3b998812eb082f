"""Readers of recordings: one file is one format."""
