"""Harmonics of the force, brought to their targets by harmonics of the drive."""
