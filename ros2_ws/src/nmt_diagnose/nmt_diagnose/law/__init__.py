"""The law of a local force that a model lacks, read from held levels by a convex problem."""
