"""What is wrong with a channel, by its samples alone."""
