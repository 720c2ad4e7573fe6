"""Find the physical effect that the shear model misses in the paper's own experiment."""

import cvxshear

closure = cvxshear.close_loop(cvxshear.load("paper"))

before, after = closure.before.estimate.quality, closure.after.estimate.quality
print(f"verdict: {closure.verdict}")
for found in closure.effects:
    print(f"{found.placed.label}: {found.parameters}")
errors = [100 * quality.max_frequency_error for quality in (before, after)]
print(f"largest frequency error: {errors[0]:.2f} % before, {errors[1]:.2f} % after")
print(
    f"on held-out structures:  {100 * closure.before.held_out:.2f} % before, {100 * closure.after.held_out:.2f} % after"
)
print(f"story stiffness: {(closure.frame.story_stiffness / 1000).round(2)} kN/m")
