"""Amplitudes, phases and harmonics of the forces of one exciter or several: one law, and what it brings them to."""
