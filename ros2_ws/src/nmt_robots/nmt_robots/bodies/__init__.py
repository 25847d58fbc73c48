"""Which bodies of a robot's file differ from the robot: asked of all joints together, before any joint alone."""
