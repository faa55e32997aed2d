"""Images alone -> their poses: structure from motion by COLMAP, scaled and upright, as a folder that `train` reads."""
