"""Identification of the propulsion by a caudal fin: command ``swimid fit-propulsion``.

``trials`` reads cruise tables and logs of straight free swimming. ``model`` has the energy recoil law of
cruise tables and the surge model of straight swimming. ``fit_propulsion`` is the command, and fits both.
``options`` has the options of the command.
"""
