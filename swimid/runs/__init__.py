"""Chains of commands for many films and logs, in a folder that holds the state of each item.

``plan`` reads a plan file and resolves it into items, ``item`` does one item in a process of its own,
``status`` reads what items left, ``batch`` does a run, ``summary`` writes the tables and the page of a run,
and ``compare_runs`` compares runs.
"""
