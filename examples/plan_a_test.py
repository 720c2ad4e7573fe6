"""Plan a test: where sensors go, and how many of them."""

from pathlib import Path

from cvxshear.planning import Declared, plan

file = Path(__file__).parent / "eight_story_design.toml"

for sensors in (2, 4, 8):
    found = plan(file, sensors=sensors, modes=3, noise=Declared(0.001, 0.01))
    print(f"{sensors} sensors: floors {found.sensors}, typical parameter to {100 * found.objective:.1f} %")
