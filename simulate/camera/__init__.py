"""Simulate cameras with distortion, and the effects of lenses and sensors."""
