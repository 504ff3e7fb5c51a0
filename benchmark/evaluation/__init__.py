"""Evaluation of localizers on data sets, and of the poses of other programs."""
