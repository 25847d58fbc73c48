"""The blind check of the diagnosis: sealed cases, campaigns, scores, baselines, calibration."""
