"""Makes scenes: procedural worlds, conditions, drone flights, and their exact renderings."""
