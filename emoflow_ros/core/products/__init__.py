"""What is told: a motion for every window, the latest twist, tracks and pictures."""
