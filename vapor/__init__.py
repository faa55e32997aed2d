"""The variational pose regressor, and the command that joins it to the filter."""
