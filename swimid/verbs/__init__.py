"""Verbs: what each command does, callable from Python; one function per module of its name."""
