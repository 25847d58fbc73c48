"""Recordings and other programs: files measured elsewhere, exports, units, calibration."""
