"""The published E-MoFlow method: a coordinate network fitted to every window by autograd.

Reference: "E-MoFlow: Learning Egomotion and Optical Flow from Event Data via Implicit
Regularization", NeurIPS 2025, arXiv 2510.12753. This file imports nothing, so that
`emoflow_ros.published.implicit_config` costs no torch.
"""
