"""The library of effects: each is a change of the rig file that the plant can simulate."""
