"""Verbs: what each command does, callable from Python; the rest are their parts."""
