"""How flights are flown, and whether they can be."""
