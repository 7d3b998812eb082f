"""The files of an evaluation's report: HTML, JSON and CSV.

It has the figures and the pictures of windows, too.
"""
