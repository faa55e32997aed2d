"""What files say, read within limits: text, JSON, YAML, arrays, and the names of other files.

Files come from others, are cut off, or were made to do harm. So sizes are checked before memory is asked for, no name
in a file leads out of its folder, and nothing is unpickled or evaluated.
"""
