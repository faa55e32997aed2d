"""Recorded and synthetic sequences: readers, writers, data sets and rendered scenes.

`reader`, `writer`, `frame` and `options` are what most need. Behind them: `recordings` (MCAP files and their messages),
`images`, `trajectories` (poses over time), `reading` (a recording -> frames), `datasets` (with a module for each layout
on disk), `estimates` (of others), `odometry_fit`, `files` and `values` (content of files), `outputs` and `atomic`
(files that are whole or not there).
"""
