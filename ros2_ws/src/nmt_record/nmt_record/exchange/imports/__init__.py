"""From a sidecar and its files to a bag of the bench."""
