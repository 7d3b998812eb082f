"""The flow of one window on a lattice, and the motion that it shows by itself."""
