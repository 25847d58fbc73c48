"""Records of an imposed motion."""
