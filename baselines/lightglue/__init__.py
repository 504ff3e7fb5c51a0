"""Learned keypoints matched by LightGlue, through kornia."""
