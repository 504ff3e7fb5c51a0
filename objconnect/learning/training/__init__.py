"""Training: pairs of images of the same ground, and the loop that learns from them."""
