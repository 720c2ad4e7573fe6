"""Plan a test: where four sensors go, how long to record, and what a counterweight would show."""

from pathlib import Path

from cvxshear.planning import Recorded, plan

file = Path(__file__).parent / "eight_story_design.toml"

for minutes in (10, 60):
    found = plan(file, sensors=4, modes=3, noise=Recorded("ambient", 60.0 * minutes))
    print(
        f"{minutes} minutes of wind: floors {found.sensors}, typical parameter to {100 * found.objective:.1f} %, "
        f"with a sensor everywhere {100 * found.everywhere.objective:.1f} %"
    )

for tests in (1, 2):
    found = plan("paper", tests=tests, goal="gravity", fresh=True, added_mass=10.0)
    gravity = found.apart[1]
    print(
        f"the paper's frame, {tests} test{'s' * (tests > 1)}: masses {[test.tolist() for test in found.tests]} kg, "
        f"gravity shown with probability {gravity.probability:.2f}"
    )
