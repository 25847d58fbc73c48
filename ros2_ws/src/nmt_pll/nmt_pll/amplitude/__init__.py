"""Amplitudes that are held: of force, response or voltage."""
