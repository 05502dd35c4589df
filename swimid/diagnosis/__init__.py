"""From trials and a model to the cause of what is left between them.

``floor`` says how large the noise is, ``lens`` weighs residuals by it, ``candidates`` tries effects,
``selection`` compares them on held-out trials, ``generic`` finds what no effect explains, ``where``
places the gap, ``advice`` names the next experiment; ``chain`` strings them together.
"""
