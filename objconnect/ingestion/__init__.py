"""Make scenes from folders of photographs."""
