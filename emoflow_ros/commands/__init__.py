"""The installed commands, one file each, and the demonstration of `make demo`.

The node's command is `node/executable.py`.
"""
