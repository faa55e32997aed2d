"""Images with true poses, as data sets lie on disk: the one entry for training; conversion to MCAP."""
