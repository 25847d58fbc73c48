"""Formats that a recording is exported in."""

FORMATS = ("uff", "csv", "npz", "h5", "mat")
