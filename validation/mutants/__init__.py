"""Mutants: small errors put into swimid on purpose, and the share of them that the tests notice.

``candidates`` lists the mutations of a module, ``recorder`` maps lines to the tests that execute them,
``runner`` runs the tests of one mutant, and ``__main__`` draws, runs and reports.
"""
