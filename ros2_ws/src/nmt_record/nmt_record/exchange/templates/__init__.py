"""Sidecars to start from, by what a file of data itself tells."""
