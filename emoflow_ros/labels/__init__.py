"""What `label` does: flow labels of many recordings, for training.

One process makes them chunk by chunk, or the workers of a Ray cluster.
"""
