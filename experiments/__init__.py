"""Scripts that measure: ours beside peers, ablations, numbers that were chosen. Not installed."""
