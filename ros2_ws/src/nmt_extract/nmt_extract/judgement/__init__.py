"""Judgement of windows: each channel by the others, the window as a whole, and which mode it is."""
