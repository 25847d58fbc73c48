"""The answer for each joint and for the log."""
