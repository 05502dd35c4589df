"""Experiments: one module for each, which is found automatically. To add an experiment, add a module.

``falling_weight``, ``towed`` and ``free_decay`` are experiments on a rig. ``cruise`` and ``free_swim`` have
robots that swim freely, ``multibody`` has any motion of a robot with links, and ``arma`` any two columns.
:mod:`swimid.logs.experiments` has the base class and the list of all experiments.
"""
