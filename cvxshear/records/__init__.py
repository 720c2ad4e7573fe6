"""A record, what its file says of it, and what it gets wrong."""
