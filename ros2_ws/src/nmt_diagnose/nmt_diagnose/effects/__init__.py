"""The library of effects: one small module each."""
