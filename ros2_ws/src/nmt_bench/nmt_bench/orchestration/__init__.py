"""What the harness starts and cleans up: domains and processes."""
