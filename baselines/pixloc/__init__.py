"""PixLoc, which aligns learned features (Sarlin et al., "Back to the Feature", CVPR 2021)."""
