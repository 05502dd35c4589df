"""Falling weight, towing and free decay: trials, the single-degree-of-freedom model, its fit and result."""
