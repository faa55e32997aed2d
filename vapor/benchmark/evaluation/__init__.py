"""What many runs are worth: all methods side by side, short sequences, other units of length, intervals over walks."""
