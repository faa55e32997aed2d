"""How wrong odometry is, from recordings that have true poses as well: white noise, drift and scale error."""
