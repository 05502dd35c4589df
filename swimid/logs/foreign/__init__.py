"""Logs of other programs: one module per format behind :class:`~swimid.logs.foreign.base.Source`.

Every module here that has a ``READER`` is found by itself; the next format is one new file.
"""

from swimid.logs.foreign.base import Column, Options, Reader, Source
from swimid.logs.foreign.registry import open_source, readers

__all__ = ["Column", "Options", "Reader", "Source", "open_source", "readers"]
