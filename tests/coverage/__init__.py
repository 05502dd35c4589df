"""Coverage of stated 95 % intervals, measured on simulated recordings of independent code.

One module per quantity. Each has ``one(seed) -> dict[str, float]``. It makes a recording, runs swimid on it,
and returns for every quantity the share of true values that lie in the stated interval. The share is 0 or 1
for a single estimate.
"""
