"""The same programs on every installed backend, against the closed form."""

from pathlib import Path

import cvxshear

experiment = cvxshear.load(Path(__file__).with_name("three_story.toml"))
comparison = cvxshear.compare_backends(experiment)

for kind in dict.fromkeys(row.kind for row in comparison.rows):
    rows = [row for row in comparison.rows if row.kind == kind and row.difference is not None]
    worst = max(rows, key=lambda row: row.difference)
    print(
        f"{kind:18s} {len(rows)} backends, farthest {worst.backend}: {worst.difference:.0e} from the {worst.reference}"
    )
