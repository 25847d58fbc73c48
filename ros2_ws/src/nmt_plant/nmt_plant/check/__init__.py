"""The check of channels and loop before a real test."""
