"""ROS 2 bags of others: numbers of messages as columns."""
