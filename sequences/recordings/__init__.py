"""MCAP files, rosbag2 folders and ROS 1 bags: their topics, their messages and the frames of tf, read and written."""
