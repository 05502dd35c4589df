"""Sequences of commands (steps) for many films and logs, in a run folder with the state of each item.

An item is an input file, or a group of input files, that passes through the steps. ``plan`` reads a plan file
and resolves it into items. ``item`` processes one item in a process of its own. ``status`` reads and writes
the state of items. ``batch`` processes all items of a run, ``summary`` writes the tables and the page of a
run, and ``compare_runs`` compares runs.
"""
