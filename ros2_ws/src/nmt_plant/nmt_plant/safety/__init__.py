"""What keeps the drive within its limits: guard of the output, limits of what is measured, watchdog."""
