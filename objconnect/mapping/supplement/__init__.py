"""Supplementing a map: detections of objects in several photographs become points."""
