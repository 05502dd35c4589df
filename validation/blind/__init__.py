"""Trials with a known hidden cause, made without any code of the package they test."""
