"""Make a scene of virtual photographs from an orthophoto and its surface model."""
