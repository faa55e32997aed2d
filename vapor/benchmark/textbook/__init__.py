"""`benchmark textbook`: our filter and network beside what a user would take instead, on the same posteriors."""
