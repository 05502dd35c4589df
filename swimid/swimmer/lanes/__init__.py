"""Many runs of one robot at once: an engine's equations, traced on symbols and compiled for SIMD lanes.

:mod:`~swimid.swimmer.lanes.symbols` runs the text of an engine on symbols, :mod:`~swimid.swimmer.lanes.source` writes the
operations that come out as a module, :mod:`~swimid.swimmer.lanes.kernel` compiles, caches and runs it.
"""
