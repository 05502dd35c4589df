"""Propulsion by a caudal fin (boxfish paper), and beat-averaged surge: ``swimid fit-propulsion``.

``trials`` reads cruise tables and straight free swims; ``model`` holds the recoil law and the surge model;
``cruise`` fits the one, ``fit_propulsion`` (the command, with ``options``) the other.
"""
