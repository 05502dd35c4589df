"""Identification for whatever model: the model interface, output error, noise, covariance, tests."""
