"""Files next to the data: sidecar, calibration sheet, levels, locks and states of an exported run."""
