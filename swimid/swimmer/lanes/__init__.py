"""Many runs of one robot at once: an engine's equations, traced on symbols and compiled for SIMD lanes.

``tracing`` runs the text of an engine on symbols and writes the operations that come out as a module,
``kernel`` compiles, keeps and runs it, also with room for what effects bring.
"""
