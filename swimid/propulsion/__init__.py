"""Propulsion by a caudal fin (boxfish paper), and surge averaged over tail beats: ``swimid fit-propulsion``.

``trials`` reads cruise tables and logs of straight free swimming. ``model`` has the energy recoil law of
cruise tables and the surge model of straight swimming. ``fit_propulsion`` is the command, and fits both.
``options`` has the options of the command.
"""
