"""Many runs of one robot at once: an engine's equations, traced on symbols and compiled for SIMD lanes.

``symbols`` runs the text of an engine on symbols, ``source`` writes the operations that come out as a module,
``kernel`` compiles, keeps and runs it; ``wide`` is a kernel with room for what effects bring, whose
exponentials and powers take ``bits`` of numbers.
"""
