"""What `evaluate` computes: protocols, metrics, results, summary, ablation and comparison.

It estimates a recording window by window and compares the estimates with ground truth.
"""
