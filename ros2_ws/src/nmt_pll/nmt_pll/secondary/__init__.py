"""Secondary resonances: the lag of a resonant order is held."""
