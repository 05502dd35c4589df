"""Logs of trials: read, imported from other programs, cleaned, and what they say without a model."""
