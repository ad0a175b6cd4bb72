"""A .touch file as a ROS 2 node."""
