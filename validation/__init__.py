"""Programs that measure swimid: blind diagnoses, coverage of intervals, faults, mutants, real gaps.

Each is started with ``python -m validation.NAME``. They run for minutes to hours, so that ``make test`` has
none of them. Simulated recordings come from ``tests.generators``, which do not import swimid.
"""
