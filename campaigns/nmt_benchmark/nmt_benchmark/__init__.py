"""Benchmarks: speed of this machine against limits and peers, and trials of a failing output."""
