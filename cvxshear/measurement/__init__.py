"""Measured and declared data: experiment, configurations, static tests, other modes, and their validation."""
