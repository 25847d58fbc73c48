"""Records of any excitation."""
