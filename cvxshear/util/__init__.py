"""What anything may use: errors, checks, quantities and units, text, writing, parallel. It knows nothing of frames."""
