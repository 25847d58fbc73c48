"""Tests that have not been made: their rows, and by how much they would separate explanations."""
