"""`vapor-benchmark real`: recordings, posteriors and pose estimates published by others."""
