"""The channels of a recording: their samples, their chain, and whether they can be right."""
