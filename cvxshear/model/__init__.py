"""The forward model: matrices and modes of the shear frame, with derivatives."""
