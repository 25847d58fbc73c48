"""rosbag2 writer and reader of the bench; recorder node."""
