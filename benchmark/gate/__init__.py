"""Small data sets for regression tests of recall (the *gate*), which come with the package."""
