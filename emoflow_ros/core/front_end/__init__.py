"""Events to positions: slices of events drawn as images, and patches found again in them."""
