"""A test in one process without ROS, and the parameters that its nodes get."""
