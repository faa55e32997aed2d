"""Quality of recordings for training."""
