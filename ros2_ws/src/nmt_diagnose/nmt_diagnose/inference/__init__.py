"""From residuals to a verdict: calibration, candidates, places, confidence."""
