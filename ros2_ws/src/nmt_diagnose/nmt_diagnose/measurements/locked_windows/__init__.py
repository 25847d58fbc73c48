"""Locked windows of phase resonance."""
