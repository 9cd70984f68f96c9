"""leadline on ROS 2."""
