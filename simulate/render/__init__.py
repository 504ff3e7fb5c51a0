"""The processes that import Blender, and the code that starts and watches them."""
