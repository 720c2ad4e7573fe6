"""Test plans from the user's view: choices, masses within limits, files, and simulated tests of the plan's values."""

import json
import re

import numpy as np
import pytest

import cvxshear
from cvxshear.planning import Declared, plan, predicted, write_template
from cvxshear.planning.choice import CRITERIA
from cvxshear.planning.planner import mass_grid
from cvxshear.util.errors import InputError
from tests.frames import configuration, experiment
from tests.planning.common import NOISE, design, tapered
from tests.studies.planning import scatter

DESIGN = """
[frame]
story_heights = 3.0

[[prior]]
kind = "nominal"
quantity = "floor_mass"
values = [20.0, 20.0, 18.0, 15.0]
std = 0.02

[[prior]]
kind = "nominal"
quantity = "story_stiffness"
values = [30e3, 28e3, 25e3, 20e3]
std = 0.1
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "design.toml"
    path.write_text(DESIGN)
    return path


def test_a_file_of_design_values_is_planned_for(file):
    found = plan(file, sensors=2, modes=3)
    assert len(found.sensors) == 2
    assert found.gap == 0.0
    assert len(found.fewer.floors) == 1
    assert len(found.more.floors) == 3
    order = [found.fewer, found.chosen, found.more, found.everywhere]
    assert [each.choice.value for each in order] == sorted((each.choice.value for each in order), reverse=True)
    assert np.all(found.chosen.floor_mass_std <= 0.02 * np.array([20.0, 20.0, 18.0, 15.0]) * (1 + 1e-9))
    table = found.to_dataframe()
    assert table["floor"][table["sensor"]].tolist() == found.sensors
    assert table["story_stiffness_N_per_m"].tolist() == [30e3, 28e3, 25e3, 20e3]
    np.testing.assert_array_equal(table["floor_mass_std_kg"], found.chosen.floor_mass_std)
    assert table[f"added_mass_kg: {found.names[0]}"].tolist() == [0.0] * 4


def test_what_was_measured_before_counts_unless_told_otherwise():
    before = plan("paper", goal="masses")
    fresh = plan("paper", goal="masses", fresh=True)
    assert before.objective < fresh.objective


def value_of(model, tests, floors, by):
    """Return the criterion of these tests with sensors at these floors."""
    problem = model.choices(tests, floors, len(tests))
    return float(by.value(problem, problem.information(np.ones(len(tests)))))


def test_masses_stay_within_what_can_be_carried_and_beat_the_grid():
    of = tapered(5, stiffness_std=0.3)
    found = plan(of, 3, 2, modes=3, noise=NOISE, added_mass=4e3)
    for test in found.tests:
        assert np.all((test >= 0) & (test <= 4e3))
    by = CRITERIA["D"]
    floors = found.chosen.floors - 1
    grid = [found.model.expected(test) for test in mass_grid(np.full(5, 4e3))]
    pairs = [value_of(found.model, [grid[i], grid[j]], floors, by) for i in range(len(grid)) for j in range(i)]
    assert found.objective <= min(pairs) * (1 + 1e-9)
    assert found.of_grid.bound <= min(pairs) * (1 + 1e-9)


def test_a_floor_that_can_carry_nothing_carries_nothing():
    found = plan(tapered(3), tests=2, added_mass=[0.0, 4e3, 0.0], noise=NOISE, modes=2)
    assert all(test[0] == test[2] == 0.0 for test in found.tests)


def test_simulated_tests_scatter_as_planned():
    """With forty samples of eight parameters, the root mean square of the ratio is known to 4 to 11 %."""
    of = design([10.0, 8.0, 7.0, 5.0], [24e3, 20e3, 16e3, 9e3], stiffness_std=0.05)
    found = plan(of, 3, 2, modes=3, noise=Declared(0.001, 0.005), added_mass=3.0)
    seen = scatter(found, 40, seed=5)
    assert np.sqrt(np.nanmean(seen**2)) == pytest.approx(1.0, abs=0.15)


def test_the_file_to_fill_in_is_the_plan(file, tmp_path):
    found = plan(file, sensors=3, tests=2, modes=2, added_mass=6.0)
    out = tmp_path / "plan.toml"
    write_template(out, found)
    with pytest.raises(InputError, match="frequencies"):
        cvxshear.load(out)
    exact = predicted(found)
    text, shapes = out.read_text(), (row for each in exact.configurations for row in each.mode_shapes.tolist())
    for each in exact.configurations:
        text = text.replace("frequencies = [nan, nan]", f"frequencies = {each.frequencies.tolist()}", 1)
    text = re.sub(r"\[nan, nan, nan\]", lambda _: str(next(shapes)), text)
    assert "nan" not in text.split("[frame]")[1]
    out.write_text(text)
    filled = cvxshear.load(out)
    assert [each.measured_floors.tolist() for each in filled.configurations] == [found.sensors] * 2
    frame = cvxshear.identify(filled).frame
    np.testing.assert_allclose(frame.floor_mass, [20, 20, 18, 15], rtol=1e-4)
    of, at = found.model, found.chosen.floors - 1
    as_designed = np.sqrt(np.diag(of.covariance([of.expected(test) for test in found.tests], at))) * of.design.sizes
    np.testing.assert_allclose(frame.floor_mass_std, as_designed[:4], rtol=5e-3)
    np.testing.assert_allclose(frame.story_stiffness_std, as_designed[4:], rtol=5e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sensors": 5}, "sensors = 5 must lie between 1 and 4"),
        ({"tests": 0}, "tests = 0 must be at least 1"),
        ({"tests": "some"}, "tests must be a whole number"),
        ({"tests": 30, "added_mass": 3.0}, "tests = 30 are more than the"),
        ({"modes": 5}, "modes = 5 must lie between 1 and 4"),
        ({"modes": [2, 1]}, "modes must be ascending"),
        ({"modes": 2.5}, "modes must be a whole number"),
        ({"noise": 0.01}, "noise must be a cvxshear.planning.Declared"),
        ({"goal": "weights"}, "goal must be one of masses, stiffnesses, all"),
        ({"criterion": "G"}, "criterion must be one of D, A, E"),
        ({"added_mass": -1.0}, "added_mass = -1 must not be less than 0"),
    ],
)
def test_a_wrong_option_is_refused(file, options, message):
    with pytest.raises(InputError, match=message):
        plan(file, **options)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('quantity = "story_stiffness"', 'quantity = "floor_mass"', "no story stiffness is expected"),
        ("[20.0, 20.0, 18.0, 15.0]", "[20.0, 20.0, 18.0]", "must agree"),
        ("story_heights", "story_height", "did you mean 'story_heights'"),
        ("[[prior]]", "[[priors]]", "unknown key 'priors'"),
        ("[frame]", "[record]\n[frame]", "plan with the measurement file that 'cvxshear modes' makes of it"),
        ("[frame]", '[frame]\nmotions = ["x", "y", "rotation"]', "the floors turn"),
    ],
)
def test_a_wrong_file_of_design_values_is_refused(file, old, new, message):
    file.write_text(DESIGN.replace(old, new))
    with pytest.raises(InputError, match=message):
        plan(file)


def test_the_command_prints_and_writes(file, tmp_path, printed):
    out = tmp_path / "plan.toml"
    said = printed("plan", file, "--sensors", "2", "--modes", "1,2", "-o", out)
    assert said.startswith("Measure floors ")
    assert "none is better" in said
    assert out.exists()
    result = json.loads(printed("plan", file, "--sensors", "2", "--modes", "1,2", "--json", "-"))
    assert len(result["sensors"]) == 2
    assert result["tests"] == [{"name": "planned test 1", "added_mass": [0.0] * 4}]
    assert result["gap"] == 0.0
    assert result["modes"] == [1, 2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--modes", "a"], "--modes must be a number of modes"),
        (["--added-mass", "1,x"], "--added-mass must be kg"),
        (["--frequency-std", "0"], "frequency_std = 0 must be greater than 0"),
    ],
)
def test_a_wrong_option_of_the_command_ends_with_2(file, refused, arguments, message):
    assert message in refused("plan", file, *arguments)


def test_what_would_lower_the_deviations_does(file):
    """Each remedy is planned again: with another noise, another mode, one sensor more, and an exact total mass."""
    found = plan(file, sensors=2, modes=2, noise=Declared(0.002, 0.01))
    half = plan(file, sensors=2, modes=2, noise=Declared(0.001, 0.005))
    more = plan(file, sensors=3, modes=2, noise=Declared(0.002, 0.01))
    third = plan(file, sensors=2, modes=3, noise=Declared(0.002, 0.01))
    assert list(found.remedies) == [
        "weigh the frame", "one sensor more", "half the noise: records four times as long", "mode 3 as well",
    ]  # fmt: skip
    weighed, with_more, exact, with_third = found.remedies.values()
    assert with_more == pytest.approx(more.typical_std, rel=1e-6)
    if half.sensors == found.sensors:
        assert exact == pytest.approx(half.typical_std, rel=1e-6)
    if third.sensors == found.sensors:
        assert with_third == pytest.approx(third.typical_std, rel=1e-6)
    file.write_text(DESIGN.replace("[frame]", "[frame]\ntotal_mass = 73.0"))
    total = plan(file, sensors=2, modes=2, noise=Declared(0.002, 0.01))
    assert weighed == pytest.approx(total.typical_std, rel=0.05)
    assert "weigh the frame" not in total.remedies


def test_deviations_are_those_of_the_frames_that_are_possible():
    """An exact design has one frame; a vague one has worse frames than the designed one on average."""
    mass, stiffness = [20.0, 20.0, 18.0, 15.0], [30e3, 28e3, 25e3, 20e3]
    for std, same in ((1e-4, True), (0.25, False)):
        found = plan(design(mass, stiffness, stiffness_std=std), 2, modes=3)
        of, at = found.model, found.chosen.floors - 1
        alone = np.sqrt(np.diag(of.covariance([of.expected(test) for test in found.tests], at)))[4:]
        ratio = found.chosen.story_stiffness_std / stiffness / alone
        assert (np.abs(ratio - 1).max() < 1e-3) == same


def test_other_frames_that_will_fit_are_listed_with_the_test_that_tells_them_apart():
    """Frequencies of three floors of 5.36 kg fit 52.5/57.6/66.1 and 155.3/31.8/40.6 kN/m; shapes distinguish them."""
    of = design([5.36] * 3, [52.5e3, 57.6e3, 66.1e3], stiffness_std=2.0, frame={"floor_masses": [5.36] * 3})
    alone = plan(of, sensors=1, modes=3)
    (other,) = alone.other_frames.frames
    np.testing.assert_allclose(other.story_stiffness, [155.3e3, 31.8e3, 40.6e3], rtol=1e-2)
    assert "will fit 2 frames" in str(alone)
    assert "to tell them apart" in str(alone)
    assert len(alone.to_dict()["other_frames"]) == 1
    assert not plan(of, sensors=2, modes=3).other_frames.frames


def test_a_report_shows_the_choice_the_picture_the_tables_and_the_bound(file, tmp_path, run):
    out = tmp_path / "plan.html"
    run("plan", file, "--sensors", "2", "--modes", "3", "--report", out)
    page = out.read_text()
    found = plan(file, sensors=2, modes=3)
    for said in (str(found).splitlines()[0], "Most would help", "The frame as designed", "<svg", "none is better"):
        assert said in page, said


def test_a_choice_that_changes_nothing_is_said_to_be_arbitrary(file, printed):
    """A single sensor has no information on shapes of free scale: every floor is nearly equal to frequencies alone."""
    found = plan(file, sensors=1, modes=2)
    assert found.chosen.choice.arbitrary
    assert found.chosen.choice.worst == pytest.approx(found.objective, rel=0.01)
    assert found.to_dict()["floors_arbitrary"]
    assert "the floors named are arbitrary" in printed("plan", file, "--sensors", "1", "--modes", "2")
    assert not plan(file, sensors=2, modes=2).chosen.choice.arbitrary


def test_the_command_prints_what_no_test_of_the_grid_can_beat(file, printed):
    said = printed("plan", file, "--modes", "2", "--added-mass", "10")
    assert "no tests with the largest added mass or half of it" in said


def three_equal(path, frame):
    """Write three equal floors on equal stories: frequencies 2 sin((2 r - 1) pi / 14) sqrt(k / m), shapes are sines."""
    angles = np.pi / 14 * np.array([2, 6, 10])
    frequencies, shapes = 5 * np.sin(angles / 2), np.sin(np.outer(angles, [1, 2, 3]))
    modes = f"frequencies = {frequencies.tolist()}\nmode_shapes = {shapes.tolist()}"
    path.write_text(f"[frame]\n{frame}\n[[configuration]]\n{modes}\n")
    return path


@pytest.mark.parametrize("fresh", [False, True])
def test_a_total_mass_that_is_known_to_some_percent_is_no_better_known_by_a_plan(fresh, tmp_path):
    """Modes determine masses up to one factor: each mass has the uncertainty of the total and of its share."""
    std = []
    for name, line in (("exact", ""), ("vague", "total_mass_std = 0.1")):
        planned = plan(three_equal(tmp_path / f"{name}.toml", f"total_mass = 30.0\n{line}"), sensors=3, fresh=fresh)
        assert ("Most would help: weigh the frame" in str(planned)) == (name == "vague")
        found = planned.to_dict()
        std.append(np.array(found["std"]["floor_mass"]) / found["frame"]["floor_mass"])
    np.testing.assert_allclose(std[1], np.hypot(std[0], 0.1), rtol=0.02)


def test_a_plan_on_measured_modes_of_a_frame_that_nobody_weighed(tmp_path, printed):
    path = three_equal(tmp_path / "modes.toml", "total_mass = 1.0\ntotal_mass_placeholder = true")
    said = printed("plan", path, "--sensors", "2")
    assert "mass, of the total" in said
    assert "mass, kg  std of mass" not in said
    found = plan(path, sensors=2)
    np.testing.assert_allclose(found.model.design.floor_mass, 1 / 3, rtol=1e-3)


def test_a_measurement_that_leaves_the_frame_open_is_not_planned_for():
    """There are two frequencies for four stories; the message names at most four of the eight unknowns."""
    mass, stiffness = [10.0, 10.0, 9.0, 8.0], [24e3, 20e3, 16e3, 10e3]
    table = configuration(mass, stiffness, modes=[1, 2])
    del table["mode_shapes"], table["mode_shape_std"], table["measured_floors"]
    with pytest.raises(InputError, match=r"does not determine .*declare design values") as refused:
        plan(cvxshear.Experiment.from_dict(experiment(mass, stiffness, table)))
    assert len(re.findall(r"[mk]\d|(?:floor|story)[ _]\w+ \d", str(refused.value))) == 4


def test_a_static_test_before_the_plan_stays_with_it_and_a_reference_without_its_state_does_not():
    mass, stiffness = [10.0, 9.0, 8.0], [24e3, 20e3, 16e3]
    pull = {"force": [0.0, 0.0, 120.0], "displacement": (120.0 * np.cumsum(1 / np.array(stiffness))).tolist()}
    tested = {"configuration": [configuration(mass, stiffness)], "static": [pull]}
    found = plan(tested, sensors=2, modes=np.int64(2))
    assert (predicted(found).to_dict()["static"][0]["force"], found.to_dict()["other_frames"]) == (pull["force"], [])
    tested["frame"] = {"total_mass": 27.0, "reference": "configuration 1"}
    assert predicted(plan(tested, sensors=2, fresh=True)).frame.reference is None
