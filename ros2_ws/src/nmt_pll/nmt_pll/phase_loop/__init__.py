"""Phase resonance: the frequency follows the phase; the paper's loop next to it."""
