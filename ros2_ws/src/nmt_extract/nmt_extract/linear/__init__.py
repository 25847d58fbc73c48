"""Linear modal tests: random excitation to modes, residuals and the plant with its exciters."""
