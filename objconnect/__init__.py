"""The object-connect network: features that know which object they lie on, aligned directly."""
