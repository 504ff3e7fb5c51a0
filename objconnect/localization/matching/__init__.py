"""Local features, retrieval, lifting to 3D points, and PnP."""
