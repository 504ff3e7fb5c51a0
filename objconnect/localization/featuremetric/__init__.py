"""Poses by direct alignment: what any network needs to become a localizer of that kind."""
