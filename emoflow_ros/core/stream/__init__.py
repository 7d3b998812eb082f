"""The stream of events before it is estimated: clocks, order, thinning, cleaning, windows."""
