"""Propulsion by a caudal fin (boxfish paper), and beat-averaged surge: ``swimid fit-propulsion``.

``trials`` reads cruise tables (``cruise_table``) and straight free swims; ``model`` holds the recoil law
and the surge model; ``cruise`` fits the one, ``surge`` the other; ``fit_propulsion`` is the verb, with
``options``.
"""
