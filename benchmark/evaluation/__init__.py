"""Localizers are run on data sets, and poses of other programs are scored."""
