"""A recorded sequence, others' estimates, or many sequences, from file to results."""
