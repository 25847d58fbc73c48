"""Several units of one type: what they share, how they scatter, and which one is odd."""
