"""Depth maps and dense point clouds: multi-view PatchMatch on the photographs of a map."""
