"""What the harness starts and cleans up: domains, processes, shared memory."""
