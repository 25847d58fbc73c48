"""Bags of the bench: written, recorded by the node, and read, also after a damage."""
