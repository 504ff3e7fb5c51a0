"""What a map knows of the things in its photographs."""
