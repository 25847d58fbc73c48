"""Frequency responses of random tests."""
