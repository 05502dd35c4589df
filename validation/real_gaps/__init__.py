"""Real recordings in which one known thing differs from the model.

Each module of ``rows`` declares the recordings of one data set as ``ROWS``. A new data set is one new file.
"""
