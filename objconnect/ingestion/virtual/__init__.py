"""Virtual photographs of an orthophoto and its surface model, which become a scene."""
