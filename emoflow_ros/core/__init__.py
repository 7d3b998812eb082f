"""Estimation core: cameras, events, windows, flow fields and egomotion. Imports no ROS.

This file imports nothing, so that `emoflow_ros.core.types.events` costs neither torch nor numba.
"""
