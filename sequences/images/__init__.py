"""Images as they are recorded: JPEG, PNG, raw pixels and video, and how they are undistorted."""
