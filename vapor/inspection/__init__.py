"""What was recorded, and whether it is good enough to train on."""
