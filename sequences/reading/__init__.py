"""A recording -> frames: which topic plays which role, and which odometry and true pose belong to which image."""
