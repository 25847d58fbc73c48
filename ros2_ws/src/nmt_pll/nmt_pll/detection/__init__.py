"""Phase and amplitude out of samples, and when a lock counts."""
