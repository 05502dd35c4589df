"""Attacks on swimid: damaged, hostile and oversized inputs, full disks, signals, and two processes at once.

``python -m validation.faults`` runs them. One module is one kind of attack; it has a list ``ATTACKS`` of
:class:`validation.faults.runner.Attack`, and a new module is found by itself.
"""
