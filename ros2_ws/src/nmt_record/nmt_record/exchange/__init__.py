"""Recordings and other programs: files measured elsewhere, exports, units, calibration."""

FORMATS = ("uff", "csv", "npz", "h5", "mat")
"""Formats that a recording is exported in."""
