"""Results of one method on one data set, and their files."""
