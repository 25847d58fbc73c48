"""A rig as a file and as equations, without ROS and without a device."""
