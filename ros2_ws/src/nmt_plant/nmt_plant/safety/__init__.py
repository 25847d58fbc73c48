"""What keeps the drive within its limits: guard of the output, limits of measured quantities, watchdog."""
