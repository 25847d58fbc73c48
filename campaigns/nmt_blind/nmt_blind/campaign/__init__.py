"""Runs the diagnosis over sealed cases and scores it."""
