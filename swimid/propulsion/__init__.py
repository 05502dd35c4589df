"""Identification of the propulsion by a caudal fin: command ``swimid fit-propulsion``.

``trials`` reads tables of cruise speeds, and averages logs of straight free swimming. ``model`` has the
energy recoil law for cruise speeds, and the surge model for straight swimming. ``fit_propulsion`` has the
command, which fits one of these two models. ``options`` has the options of the command.
"""
