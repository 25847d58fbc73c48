"""What imported numbers say of themselves and of each other, before any model."""
