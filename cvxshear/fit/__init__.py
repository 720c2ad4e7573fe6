"""The efficient estimator: misfit, step programs, starts, noise, uncertainty, result."""
