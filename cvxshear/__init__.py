"""cvxshear: floor masses and story stiffnesses of shear-type frames from measured modes."""
