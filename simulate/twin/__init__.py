"""Real places: from an orthophoto and a surface model to a place that can be rendered."""
