"""The process that owns a converter, and the side that feeds it."""
