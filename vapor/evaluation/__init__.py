"""What trajectories, beliefs and posteriors are worth against true poses."""
