"""What is wrong with a log itself, looked at before any mechanics."""
