"""What scatters in observations: floors, scatter of repeats and of neighbours, settling."""
