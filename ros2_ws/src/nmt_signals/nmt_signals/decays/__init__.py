"""Free decays: the slow amplitude of one mode, its frequency and decay rate."""
