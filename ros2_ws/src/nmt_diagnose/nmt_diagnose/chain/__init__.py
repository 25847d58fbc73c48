"""Errors of the measuring chain as columns: what a healthy laboratory may be off by."""
