"""Converters of a bench: which one a test drives, and the check that it has passed."""
