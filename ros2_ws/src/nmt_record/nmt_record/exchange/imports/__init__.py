"""From a sidecar and its files to a bag of the bench, and what is checked on the way."""
