"""The gap between a rig and its model: where it lies, which unmodelled effect causes it, how far it shrinks."""
