"""What a real side tells: tests, observables and their uncertainty."""
