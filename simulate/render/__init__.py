"""The processes that import Blender, and those who watch over them."""
