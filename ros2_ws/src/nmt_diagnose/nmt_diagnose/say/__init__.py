"""Results of a diagnosis: sentences, rows of diagnosis.json, maps and tests of residuals."""
