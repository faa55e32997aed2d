"""Recordings: sequences rendered or read once, shown to the network once, and replayed as often as needed."""
