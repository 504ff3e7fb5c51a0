"""PixLoc (Sarlin et al., "Back to the Feature", CVPR 2021): learned features, aligned directly."""
