"""Files swimid reads and writes, one module per format.

Nothing here computes. Every reader raises :class:`swimid.errors.InputError` naming the
file and the place in it; every writer writes the whole file or leaves the old one alone.
"""
