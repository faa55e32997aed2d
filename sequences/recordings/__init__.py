"""MCAP files and rosbag2 folders: their topics, their messages and the frames of tf, read and written."""
