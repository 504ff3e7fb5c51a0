"""Build, measure, diagnose and supplement sparse maps; reconstruct dense depth."""
