"""The commands `replay` and `info`, and the demonstration of `make demo`.

`evaluate`, `label` and `simulate` stand in the folders of what they do.
"""
