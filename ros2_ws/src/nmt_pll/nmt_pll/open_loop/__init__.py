"""Drives whose frequency is given: sweeps, stepped sines, noise."""
