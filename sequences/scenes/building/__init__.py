"""Buildings of which a number draws everything: plan, rooms, furniture, paint, walks, camera and odometry."""
