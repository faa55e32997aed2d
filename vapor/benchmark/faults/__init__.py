"""`vapor-benchmark faults`: the same walks without and with a fault of the camera or the odometry."""
