"""What was measured and declared: experiment, configurations, static tests, other modes, and all their validation."""
