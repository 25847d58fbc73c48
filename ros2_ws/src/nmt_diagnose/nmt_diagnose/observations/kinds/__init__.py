"""Observables of each kind of test, from windows, records and tables."""
