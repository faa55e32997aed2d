"""`vapor-benchmark localization`: many trials on synthetic scenes, and what they add up to."""
