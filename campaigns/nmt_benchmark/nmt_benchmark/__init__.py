"""Benchmarks: speed of this machine beside limits and peers, and trials of a failing output."""
