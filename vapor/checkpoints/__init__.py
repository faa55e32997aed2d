"""Model files: what is in them, how images err until they are calibrated, where those that ship lie."""
