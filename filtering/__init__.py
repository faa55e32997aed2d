"""Mathematics of localization on SE(3): poses, particles, the filter and the smoother. Opens no file."""
