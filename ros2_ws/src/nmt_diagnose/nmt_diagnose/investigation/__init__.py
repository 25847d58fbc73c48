"""A bench that chooses its tests until the gap between a model and a rig has a name."""
