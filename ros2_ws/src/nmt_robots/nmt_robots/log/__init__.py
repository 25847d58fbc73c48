"""Logs of joints: what their columns are (a sidecar), and the columns themselves."""
