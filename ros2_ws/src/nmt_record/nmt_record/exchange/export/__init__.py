"""From a bag to files that others read."""
