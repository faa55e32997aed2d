"""A network from recordings: what is held out, epoch after epoch, calibrated and checked at its end."""
