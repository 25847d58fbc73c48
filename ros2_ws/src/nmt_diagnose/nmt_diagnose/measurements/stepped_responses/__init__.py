"""Frequency responses at held amplitudes."""
