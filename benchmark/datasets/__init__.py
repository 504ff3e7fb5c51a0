"""What localizers are scored on, whatever its form."""
