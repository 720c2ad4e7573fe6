"""Tools for every module: errors, checks, quantities and units, text, writing, parallel; independent of frames."""
