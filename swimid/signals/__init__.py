"""Signals: what can be said of a logged channel without a model."""
