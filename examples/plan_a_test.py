"""Plan a test: where four sensors go, and how long to record."""

from pathlib import Path

from cvxshear.planning import Recorded, plan

file = Path(__file__).parent / "eight_story_design.toml"

for minutes in (10, 60):
    found = plan(file, sensors=4, modes=3, noise=Recorded("ambient", 60.0 * minutes))
    print(
        f"{minutes} minutes of wind: floors {found.sensors}, typical parameter to {100 * found.objective:.1f} %, "
        f"with a sensor everywhere {100 * found.everywhere.objective:.1f} %"
    )
