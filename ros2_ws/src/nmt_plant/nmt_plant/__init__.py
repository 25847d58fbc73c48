"""The rig: structural models, shaker, sensors, time integration, reference solutions; plant node."""
