"""Motions that the structure feeds: held at an amplitude, or released and passed."""
