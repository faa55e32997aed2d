"""Training of a network on recordings, some of which are held out; its calibration and check."""
