"""Frequency responses and secondary resonances that a measured backbone predicts."""
