"""Propulsion by a caudal fin (boxfish paper): cruise tables, straight swims, the model and its fit."""
