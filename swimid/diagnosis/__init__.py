"""From trials and a model to the cause of what is left between them.

``lens`` weighs residuals by the noise, ``chance`` says what differs between trials, ``bench`` fits,
``candidates`` tries effects, ``gram`` compares them on held-out trials, ``remainder`` and ``generic`` find
what no effect explains, ``floor`` says how large the noise is, ``places`` where the gap is, ``shrinkage`` how
far it closes, ``advice`` names the next experiment; ``chain`` strings them together, and ``answer`` says it.
"""
