"""Find what the shear model lacks in the paper's own experiment."""

import cvxshear

closure = cvxshear.close_loop(cvxshear.load("paper"))

before, after = closure.before.estimate.quality, closure.after.estimate.quality
print(f"verdict: {closure.verdict}")
for found in closure.effects:
    print(f"the shear model lacks {found.placed.label}: {found.parameters}")
print(
    f"largest frequency error: {100 * before.max_frequency_error:.2f} % before, {100 * after.max_frequency_error:.2f} % after"
)
print(
    f"on held-out structures:  {100 * closure.before.held_out:.2f} % before, {100 * closure.after.held_out:.2f} % after"
)
print(f"story stiffness: {(closure.frame.story_stiffness / 1000).round(2)} kN/m")
