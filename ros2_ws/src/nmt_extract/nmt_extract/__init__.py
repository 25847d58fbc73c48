"""Harmonics and modal properties from locked windows, live and from bags; extraction node."""
