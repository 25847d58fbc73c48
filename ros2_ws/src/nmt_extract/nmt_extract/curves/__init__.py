"""Curves through many points: responses of sweeps and along the phase lag, force surfaces, jumps, limit cycles."""
