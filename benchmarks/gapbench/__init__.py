"""GapBench: gaps between a model and its trials whose cause is known, for any tool that names causes.

``make`` writes the cases and, apart from them, their labels (``labels``), with the generators of
``validation.blind`` and recordings of others (``real``). ``answers`` is what a tool says of them, ``tools``
has programs say it: ``swimid``, another checkout of it, and two peers in its place (``peers``): ``bic`` and
``regression``. ``scoring`` holds the answers against the labels, ``table`` prints it.
``python -m benchmarks.gapbench`` runs all of it.
"""
