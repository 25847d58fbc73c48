"""Processes, their clocks, and work that is spread over them."""
