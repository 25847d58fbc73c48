"""What a real side contains: tests, observables and their uncertainty."""
