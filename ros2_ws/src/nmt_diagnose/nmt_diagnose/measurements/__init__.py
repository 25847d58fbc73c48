"""Kinds of measurement of a real side: each is read, predicted, judged and drawn by its own folder."""
