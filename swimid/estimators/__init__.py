"""Estimators: parameters from measurements, with honest uncertainty, for whatever model."""
