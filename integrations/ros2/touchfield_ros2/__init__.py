"""A ROS 2 package that plays a ``.touch`` file."""
