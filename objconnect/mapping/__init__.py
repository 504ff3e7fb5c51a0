"""Build and diagnose sparse maps, add points on small objects, reconstruct dense depth."""
