"""Arrays, compiled functions and ramps."""
