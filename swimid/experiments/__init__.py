"""What a trials file means: one module per family of experiments.

Each turns a trials file, its robot and its logs into a model and the trials that model
simulates (:class:`swimid.experiments.base.Experiment`).
"""
