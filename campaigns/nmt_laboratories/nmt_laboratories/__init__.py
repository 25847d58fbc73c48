"""Simulated laboratories, whose equations, integrators and chains are their own, and campaigns over their seeds.

A command each: ``python -m nmt_laboratories.<module>`` in ``./nmt shell``.
"""
