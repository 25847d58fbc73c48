"""The search for explanations, and where it begins."""
