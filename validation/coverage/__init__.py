"""Coverage of stated 95 % intervals and false alarms of checks, on simulated recordings of independent code.

There is one module for each estimator. Each has ``REPEATS`` and ``one(seed) -> dict[str, float]``. It makes
a recording, runs swimid on it, and returns for every quantity the share of true values that lie in the
stated interval. The share is 0 or 1 for a single estimate. Names with ``alarm:`` are checks of the result:
their share is 1 if the check warns or fails on a recording without faults.
"""
