"""Commands accept every sort of valid measurement. They end in results or in a message, never in a traceback."""

import json

import numpy as np
import pytest

from cvxshear import Experiment, close_loop
from cvxshear.util.errors import CvxshearError
from tests.fe.experiments import simulated

EFFECTS = (None, "gravity", "joint_rotation", "sensor_gain", "ground_spring", "added_mass", "story_change")
STDS = ("frequency_std", "mode_shape_std")


def odd(seed):
    """Return a frame tested at some floors and in some states. Optional keys are left out at random."""
    rng = np.random.default_rng(seed)
    stories, configurations = int(rng.integers(2, 4)), int(rng.integers(1, 3))
    floors = sorted((rng.choice(stories, int(rng.integers(1, stories + 1)), replace=False) + 1).tolist())
    declared, truth = simulated(
        EFFECTS[int(rng.integers(len(EFFECTS)))],
        stories=stories, configurations=configurations, rng=rng,
        measured_floors=floors, modes=int(rng.integers(1, stories + 1)),
    )  # fmt: skip
    if rng.random() < 0.5:
        for number, table in enumerate(declared["configuration"]):
            table["state"] = ("as built", "repaired")[number]
    for table in declared["configuration"]:
        for key in STDS if rng.random() < 0.5 else ():
            table.pop(key, None)
        if rng.random() < 0.2:
            for key in ("mode_shapes", "mode_shape_std", "measured_floors"):
                table.pop(key, None)
    nominal = (np.array(truth["story_stiffness"]) * rng.uniform(0.8, 1.2, stories)).tolist()
    ratio = {"kind": "ratio", "quantity": "floor_mass", "of": stories, "to": 1, "value": 1.1, "std": 0.03}
    soft = [{"kind": "nominal", "quantity": "story_stiffness", "values": nominal, "std": 0.1}, ratio]
    declared["prior"] = [prior for prior in soft if rng.random() < 0.4]
    return declared


@pytest.mark.parametrize("seed", range(5))
def test_a_loop_ends_in_a_verdict_or_in_words(seed):
    try:
        result = close_loop(Experiment.from_dict(odd(seed))).to_dict()
    except CvxshearError:
        return
    json.dumps(result, allow_nan=False)
    assert result["verdict"] in {"adequate", "explained", "located", "ambiguous", "unexplained"}
    assert all(0.0 <= item["probability"] <= 1.0 for item in result["candidates"])


def written(declared, path):
    """Write a measurement as TOML. Numbers, texts and lists are the same in JSON and TOML."""
    tables = [("[frame]", declared["frame"])]
    tables += [(f"[[{key}]]", table) for key in ("configuration", "prior") for table in declared[key]]
    lines = [line for head, table in tables for line in (head, *(f"{k} = {json.dumps(v)}" for k, v in table.items()))]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(("seed", "report"), [(105, True), (106, False)])
def test_commands_end_in_results_or_in_words(seed, report, run, shared_loops, tmp_path):
    """The files include a soft prior, configurations without shapes, and a single sensor."""
    path = written(odd(seed), tmp_path / "odd.toml")
    written_to = ["--report", tmp_path / "report.html"] if report else []
    for command in (["check"], ["identify"], ["plan"], ["loop", *written_to]):
        status, out, err = run(command[0], path, *command[1:])
        assert status in (0, 1, 2)
        assert "Traceback" not in out + err
        assert (status == 2) == err.startswith("cvxshear: ")
