"""Phase-locked loop for phase resonance testing; PLL node."""
