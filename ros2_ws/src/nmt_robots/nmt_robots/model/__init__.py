"""A robot as its file says: joints, limits, and the torque of its rigid bodies."""
