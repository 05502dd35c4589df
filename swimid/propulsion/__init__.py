"""Propulsion by a caudal fin (boxfish paper), and beat-averaged surge: ``swimid fit-propulsion``.

``trials`` reads cruise tables and straight free swims. ``model`` has the recoil law and the surge model.
``cruise`` fits the recoil law. ``fit_propulsion`` is the command, and fits the surge model; ``options`` are
its options.
"""
