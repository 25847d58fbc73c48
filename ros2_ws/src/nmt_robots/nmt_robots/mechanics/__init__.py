"""Torque that the rigid bodies leave over, as a sum of columns: friction, armature, and their rivals."""
