"""Recall, intervals, paired tests and calibration of uncertainties."""
