"""Test plans from the user's view: choices, masses within limits, files, and simulated tests of the plan's values."""

import json
import re

import numpy as np
import pytest
from scipy.linalg import eigh

import cvxshear
from cvxshear.cli import main
from cvxshear.planning import Declared, MassLimits, Recorded, plan, predicted, read_design, write_template
from cvxshear.planning.criteria import criterion_named
from cvxshear.planning.tested_model import possible
from cvxshear.util.errors import InputError
from tests import closed
from tests.frames import configuration, experiment
from tests.planning.common import NOISE, design, tapered
from tests.studies.planning import paper_design, right_verdicts, scatter, vague_designs

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


@pytest.fixture(scope="module")
def paper():
    return plan("paper", tests="declared", goal="gravity")


def test_a_file_of_design_values_is_planned_for(file):
    found = plan(file, sensors=2, modes=3)
    assert len(found.sensors) == 2
    assert found.gap == 0.0
    assert len(found.fewer.floors) == 1
    assert len(found.more.floors) == 3
    order = [found.fewer, found.chosen, found.more, found.everywhere]
    assert [each.objective for each in order] == sorted((each.objective for each in order), reverse=True)
    assert np.all(found.chosen.floor_mass_std <= 0.02 * np.array([20.0, 20.0, 18.0, 15.0]) * (1 + 1e-9))
    table = found.to_dataframe()
    assert table["floor"][table["sensor"]].tolist() == found.sensors
    assert table["story_stiffness_N_per_m"].tolist() == [30e3, 28e3, 25e3, 20e3]
    np.testing.assert_array_equal(table["floor_mass_std_kg"], found.chosen.floor_mass_std)
    assert table[f"added_mass_kg: {found.names[0]}"].tolist() == [0.0] * 4


def test_the_papers_three_structures_can_show_gravity(paper):
    """With assumed noise of 0.2 and 1 %, the loop finds gravity in the measured data, at 12 standard deviations."""
    gravity = paper.apart[1]
    assert gravity.distance > 10
    assert gravity.probability > 0.99
    assert [list(test) for test in paper.tests] == [[13.5, 8.6], [27.5, 22.6], [41.0, 36.1]]


def test_one_structure_cannot_show_gravity_whatever_it_carries_but_bare_and_ten_kilograms_can():
    alone = plan("paper", tests=1, goal="gravity", fresh=True, added_mass=41.0)
    assert alone.apart[1].probability < 0.01
    pair = plan("paper", tests=2, goal="gravity", fresh=True, added_mass=10.0)
    assert pair.apart[1].probability > 0.9
    assert list(pair.tests[0]) == [0.0, 0.0]


def test_one_structure_can_show_gravity_where_the_design_stiffness_is_known_well_enough():
    """Gravity reduces a stiffness known to 2 % by 1.1 P / h: 1.1 x 9.81 x (m + 41) / 0.39 N/m in the upper story."""
    found = plan(paper_design(0.02), tests=1, goal="gravity", added_mass=41.0)
    assert found.apart[1].distance > 5
    assert plan(paper_design(0.05), tests=1, goal="gravity", added_mass=41.0).apart[1].distance < 4


def test_what_was_measured_before_counts_unless_told_otherwise():
    before = plan("paper", goal="masses")
    fresh = plan("paper", goal="masses", fresh=True)
    assert before.objective < fresh.objective


def value_of(averaged, tests, floors, by):
    """Return the criterion of these tests with sensors at these floors."""
    problem = averaged.choices(tests, floors, len(tests))
    return float(by.value(problem, problem.information(np.ones(len(tests)))))


def test_masses_stay_within_what_can_be_carried_and_beat_the_grid():
    of = tapered(5, stiffness_std=0.3)
    found = plan(of, 3, 2, modes=3, noise=NOISE, added_mass=4e3, added_mass_total=7e3)
    for test in found.tests:
        assert np.all((test >= 0) & (test <= 4e3))
        assert test.sum() <= 7e3 * (1 + 1e-9)
    limits = MassLimits.of(4e3, 7e3, 5)
    by = criterion_named("D")
    floors = found.chosen.floors - 1
    grid = [found.averaged.expected(test) for test in limits.grid()]
    pairs = [value_of(found.averaged, [grid[i], grid[j]], floors, by) for i in range(len(grid)) for j in range(i)]
    assert found.objective <= min(pairs) * (1 + 1e-9)
    assert found.grid_bound <= min(pairs) * (1 + 1e-9)
    assert found.frames > 1


def test_a_floor_that_can_carry_nothing_carries_nothing():
    found = plan(tapered(3), tests=2, added_mass=[0.0, 4e3, 0.0], noise=NOISE, modes=2)
    assert all(test[0] == test[2] == 0.0 for test in found.tests)


def test_simulated_tests_scatter_as_planned():
    """With forty samples of eight parameters, the root mean square of the ratio is known to 4 to 11 %."""
    of = design([10.0, 8.0, 7.0, 5.0], [24e3, 20e3, 16e3, 9e3], stiffness_std=0.05)
    found = plan(of, 3, 2, modes=3, noise=Declared(0.001, 0.005), added_mass=3.0)
    seen = scatter(found, 40, seed=5)
    assert np.sqrt(np.nanmean(seen**2)) == pytest.approx(1.0, abs=0.15)


def test_simulated_tests_give_the_right_verdict_as_often_as_planned():
    of = design([10.0, 7.5, 5.0], [1800.0, 1200.0, 600.0], stiffness_std=0.05, frame={"story_heights": 1.0})
    found = plan(of, modes=3, noise=Declared(0.001, 0.005), goal="joint_rotation=0.05")
    seen = right_verdicts(found, 30, seed=3)["joint rotation"]
    assert 0.5 < found.apart[1].probability < 1.0
    assert seen == pytest.approx(found.apart[1].probability, abs=0.2)


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
    np.testing.assert_allclose(frame.floor_mass_std, found.chosen.floor_mass_std, rtol=5e-3)
    np.testing.assert_allclose(frame.story_stiffness_std, found.chosen.story_stiffness_std, rtol=5e-3)


def test_an_earlier_results_json_is_what_is_known(tmp_path):
    result = cvxshear.identify(cvxshear.load("paper"))
    path = tmp_path / "paper.json"
    path.write_text(json.dumps(result.to_dict()))
    of = read_design(path)
    np.testing.assert_allclose(of.floor_mass, result.frame.floor_mass)
    assert plan(path, modes=2).chosen.floor_mass_std[0] <= result.frame.floor_mass_std[0]
    path.write_text('{"verdict": "adequate"}')
    with pytest.raises(InputError, match="holds no frame with standard deviations"):
        read_design(path)
    path.write_text("[")
    with pytest.raises(InputError, match="is not valid JSON"):
        read_design(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sensors": 5}, "sensors = 5 must lie between 1 and 4"),
        ({"tests": 0}, "tests = 0 must lie between 1"),
        ({"tests": "some"}, "tests must be a whole number or 'declared'"),
        ({"tests": "declared"}, "declares no tests"),
        ({"tests": 30, "added_mass": 3.0}, "tests = 30 are more than the"),
        ({"modes": 5}, "modes = 5 must lie between 1 and 4"),
        ({"modes": [2, 1]}, "modes must be ascending"),
        ({"goal": "weights"}, "effect must be one of"),
        ({"goal": " "}, "must be a text that is not empty"),
        ({"criterion": "d"}, "criterion must be one of"),
        ({"added_mass": -1.0}, "added_mass = -1 must not be less than 0"),
        ({"added_mass_total": 3.0}, "needs one of each floor"),
        ({"backend": "osqp"}, "backend must be one of"),
        ({"noise": Recorded("ambient", 1.0)}, "periods of the lowest mode"),
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
    ],
)
def test_a_wrong_file_of_design_values_is_refused(file, old, new, message):
    file.write_text(DESIGN.replace(old, new))
    with pytest.raises(InputError, match=message):
        plan(file)


def test_the_command_prints_and_writes(file, tmp_path, capsys):
    out = tmp_path / "plan.toml"
    with pytest.raises(SystemExit) as ended:
        main(["plan", str(file), "--sensors", "2", "--modes", "1,2", "-o", str(out)])
    assert ended.value.code == 0
    said = capsys.readouterr().out
    assert said.startswith("Measure floors ")
    assert "none is better" in said
    assert out.exists()
    with pytest.raises(SystemExit):
        main(["plan", str(file), "--sensors", "2", "--modes", "1,2", "--json", "-"])
    result = json.loads(capsys.readouterr().out)
    assert len(result["sensors"]) == 2
    assert result["tests"] == [{"name": "planned test 1", "added_mass": [0.0] * 4}]
    assert result["gap"] == 0.0
    assert result["modes"] == [1, 2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--modes", "a"], "--modes must be a number of modes"),
        (["--added-mass", "1,x"], "--added-mass must be kg"),
        (["--damping", "0.1"], "need --duration"),
        (["--duration", "600", "--frequency-std", "0.1"], "give --duration"),
    ],
)
def test_a_wrong_option_of_the_command_ends_with_2(file, capsys, arguments, message):
    with pytest.raises(SystemExit) as ended:
        main(["plan", str(file), *arguments])
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def test_the_command_shows_quantities_in_the_units_that_were_asked_for(file, run):
    asked = ("plan", file, "--modes", "2", "--added-mass", "2000", "--tests", "2")
    status, out, _ = run(*asked, "--units", "t,kN,mm")
    assert status == 0
    assert "mass, t" in out
    assert "stiffness, kN/mm" in out
    assert "added mass, t" in out
    assert "added mass, kg" in run(*asked)[1]
    status, out, err = run(*asked, "--units", "lb")
    assert (status, out) == (2, "")
    assert "there is no display unit 'lb'" in err


def test_vague_design_values_are_averaged_over_and_what_is_promised_is_their_average():
    """Compare with the root mean square over two hundred frames drawn from the priors: within 5 % on average."""
    found = vague_designs(frames=3, others=200, seed=3)
    at_design, averaged = (
        np.concatenate([each[place][len(each[place]) // 2 :] for each in found]) for place in range(2)
    )
    assert at_design.mean() > 1.08
    assert averaged.mean() == pytest.approx(1.0, abs=0.05)
    assert np.abs(averaged - 1).max() < np.abs(at_design - 1).max()


def test_firm_design_values_are_taken_as_they_are_and_a_declared_total_is_kept():
    firm, vague = (design([9.0, 7.0, 5.0], [2e3, 1.5e3, 1e3], stiffness_std=std) for std in (0.1, 0.3))
    assert possible(firm) == (firm,)
    drawn = possible(vague)
    assert drawn[0] is vague
    logs = np.array([each.story_stiffness / vague.story_stiffness - 1 for each in drawn])
    np.testing.assert_allclose(np.sqrt(np.mean(logs**2, axis=0)), 0.3, rtol=0.25)
    single = possible(design([9.0], [2e3], stiffness_std=0.2))
    spread = np.array([each.story_stiffness[0] / 2e3 - 1 for each in single])
    assert np.sqrt(np.mean(spread**2)) == pytest.approx(0.2, rel=1e-9)
    assert np.mean(spread) == pytest.approx(0.0, abs=1e-12)
    heavy = design([9.0, 7.0, 5.0], [2e3, 1.5e3, 1e3], mass_std=0.3, frame={"total_mass": 21.0})
    totals = [each.floor_mass.sum() for each in possible(heavy)]
    np.testing.assert_allclose(totals, 21.0, rtol=1e-12)
    assert np.ptp([each.floor_mass[0] for each in possible(heavy)]) > 1.0


def test_a_choice_that_changes_nothing_is_said_to_be_arbitrary(file, capsys):
    """A single sensor has no information on shapes of free scale: every floor is nearly equal to frequencies alone."""
    found = plan(file, sensors=1, modes=2)
    assert found.chosen.arbitrary
    assert found.chosen.worst == pytest.approx(found.objective, rel=0.01)
    assert found.to_dict()["floors_arbitrary"]
    with pytest.raises(SystemExit):
        main(["plan", str(file), "--sensors", "1", "--modes", "2"])
    assert "the floors named are arbitrary" in capsys.readouterr().out
    assert not plan(file, sensors=2, modes=2).chosen.arbitrary


def test_the_command_prints_what_a_test_must_reach_and_what_no_test_of_the_grid_can_beat(file, run):
    out = run("plan", file, "--modes", "2", "--goal", "ground_spring@3=500")[1]
    assert "500 N/m" in out
    assert "90 % are needed" in out
    assert "masses of the limit or half of it" in run("plan", file, "--modes", "2", "--added-mass", "10")[1]


@pytest.mark.parametrize("fresh", [False, True])
def test_a_total_mass_that_is_known_to_some_percent_is_no_better_known_by_a_plan(fresh, tmp_path):
    """Modes determine masses up to one factor: each mass has the uncertainty of the total and of its share."""
    angles = np.pi / 14 * np.array([2, 6, 10])
    shapes = np.sin(angles[:, None] * [1, 2, 3])
    declared = (
        "[frame]\ntotal_mass = 30.0\n{}\n[[configuration]]\n"
        f"frequencies = {(5 * np.sin(angles / 2)).tolist()}\nmode_shapes = {shapes.tolist()}\n"
    )
    std = []
    for name, line in (("exact", ""), ("vague", "total_mass_std = 0.1")):
        (tmp_path / f"{name}.toml").write_text(declared.format(line))
        planned = plan(tmp_path / f"{name}.toml", sensors=3, fresh=fresh)
        assert planned.rests_on_total == (name == "vague")
        assert ("weigh the frame" in str(planned)) == (name == "vague")
        found = planned.to_dict()
        std.append(np.array(found["std"]["floor_mass"]) / found["frame"]["floor_mass"])
    np.testing.assert_allclose(std[1], np.hypot(std[0], 0.1), rtol=0.02)


def test_a_plan_on_measured_modes_of_a_frame_that_nobody_weighed(tmp_path, capsys):
    """Three equal floors on equal stories: frequencies 2 sin((2 r - 1) pi / 14) sqrt(k / m), shapes are sines."""
    angles = np.pi / 14 * np.array([2, 6, 10])
    shapes = np.sin(angles[:, None] * [1, 2, 3])
    (tmp_path / "modes.toml").write_text(
        "[frame]\ntotal_mass = 1.0\ntotal_mass_placeholder = true\n[[configuration]]\n"
        f"frequencies = {(5 * np.sin(angles / 2)).tolist()}\nmode_shapes = {shapes.tolist()}\n"
    )
    with pytest.raises(SystemExit) as done:
        main(["plan", str(tmp_path / "modes.toml"), "--sensors", "2"])
    said = capsys.readouterr().out
    assert not done.value.code
    assert "mass, of the total" in said
    assert "mass, kg  as planned" not in said
    found = plan(tmp_path / "modes.toml", sensors=2)
    np.testing.assert_allclose(found.model.design.floor_mass, 1 / 3, rtol=1e-3)


def test_a_plan_on_measured_modes_expects_the_measured_frequencies_with_what_the_loop_found():
    """A ground spring carries a third of the load at the top: a shear frame's first frequency is percents off."""
    mass, stiffness = np.array([10.0, 10.0, 9.0, 8.0]), np.array([24e3, 20e3, 16e3, 10e3])
    drift = np.eye(4) - np.eye(4, k=-1)
    M, K = np.diag(mass), (drift.T * stiffness) @ drift
    K[3, 3] += 6e3
    measured = np.sqrt(eigh(K, M, eigvals_only=True)) / (2 * np.pi)
    tests, rng = [], np.random.default_rng(3)
    for name, added in (("bare", [0.0] * 4), ("loaded", [0.0, 0.0, 4.0, 0.0])):
        squares, shapes = eigh(K, M + np.diag(added))
        frequencies = np.sqrt(squares) / (2 * np.pi)
        frequencies = frequencies * (1 + 0.001 * rng.standard_normal(4))
        shapes = shapes / np.abs(shapes).max(axis=0) + 0.005 * rng.standard_normal((4, 4))
        known = {"frequency_std": 0.001, "mode_shape_std": 0.005, "mode_shapes": shapes.T.tolist()}
        tests.append({"name": name, "added_mass": added, "frequencies": frequencies.tolist(), **known})
    declared = {"frame": {"total_mass": 37.0, "story_heights": 0.4}, "configuration": tests}
    of = cvxshear.Experiment.from_dict(declared)
    found = plan(of, modes=3, loop=True)
    assert "frequencies to 0.1 %, shapes to 0.5 %" in str(found)
    assert [placed.label for placed in found.model.design.effects] == ["ground spring at floor 4"]
    np.testing.assert_allclose([each.frequency for each in found.expected_modes], measured[:3], rtol=2e-3)
    assert found.misfit is None
    without = plan(of, modes=3)
    assert abs(without.misfit.error) > 0.02
    assert without.misfit.measured in np.concatenate([each["frequencies"] for each in tests])


@pytest.mark.usefixtures("shared_loops")
def test_the_state_that_is_tested_again_is_the_one_asked_for():
    mass, stiffness = [10.0, 10.0, 9.0, 8.0], np.array([24e3, 20e3, 16e3, 10e3])
    softer = stiffness * [1.0, 0.7, 1.0, 1.0]
    known = {"rng": np.random.default_rng(4), "frequency_noise": 0.001, "shape_noise": 0.01}
    before, after = (configuration(mass, each, **known) for each in (stiffness, softer))
    tests = [{**before, "name": "sound"}, {**after, "name": "damaged"}]
    declared = experiment(mass, stiffness, *tests)
    declared["frame"]["reference"] = "sound"
    of = cvxshear.Experiment.from_dict(declared)
    for state, table in (("sound", before), ("damaged", after)):
        found = plan(of, modes=2, loop=True, configuration=state)
        expected = [each.frequency for each in found.expected_modes]
        np.testing.assert_allclose(expected, table["frequencies"][:2], rtol=2e-3)
        assert predicted(found).configurations[-1].state == state
    with pytest.raises(InputError, match="configuration must be one of"):
        plan(of, loop=True, configuration="broken")


def test_a_measurement_that_leaves_the_frame_open_is_not_planned_for():
    """There are two frequencies for four stories; the message names at most four of the eight unknowns."""
    mass, stiffness = [10.0, 10.0, 9.0, 8.0], [24e3, 20e3, 16e3, 10e3]
    table = configuration(mass, stiffness, modes=[1, 2])
    del table["mode_shapes"], table["mode_shape_std"], table["measured_floors"]
    with pytest.raises(InputError, match=r"does not determine .*declare design values") as refused:
        plan(cvxshear.Experiment.from_dict(experiment(mass, stiffness, table)))
    assert len(re.findall(r"[mk]\d|(?:floor|story)[ _]\w+ \d", str(refused.value))) == 4


def test_a_loop_needs_a_measurement_and_a_result_without_heights_says_so(file, tmp_path):
    with pytest.raises(InputError, match="a file with measured modes"):
        plan(file, loop=True)
    path = tmp_path / "loop.json"
    path.write_text(json.dumps(closed.paper().to_dict()))
    with pytest.raises(InputError, match="cannot be made again without the measurement"):
        plan(path)
