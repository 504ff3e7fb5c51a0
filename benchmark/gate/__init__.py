"""The scenes of the regression gate, which come with the package."""
