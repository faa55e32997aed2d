"""Pages: the findings of a command as one HTML file that needs no network."""
