"""Test the keys of a measurement file and their meaning."""

import dataclasses
import datetime
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import cvxshear
from cvxshear.io.toml import load
from cvxshear.measurement.experiment import Configuration, Experiment, Frame, Prior
from cvxshear.planning import read_design
from cvxshear.util.errors import InputError
from tests.frames import DESIGNS, EXAMPLES, MEASURED

FREQUENCIES = [2.0, 5.0, 8.0]
SHAPES = [[0.4, 0.8, 1.0], [-1.0, -0.3, 0.9], [0.8, -1.0, 0.5]]
NOMINAL = {"kind": "nominal", "quantity": "story_stiffness", "values": [3e6, 2e6, 1e6], "std": 0.1}


def state(**keys):
    """Return a three-story configuration. The keys are added to the two required ones or replace them."""
    return {"frequencies": FREQUENCIES, "mode_shapes": SHAPES, **keys}


def experiment(*, frame=None, prior=(), **keys):
    """Return an experiment with that single configuration, on a frame of 30 kg."""
    declared = {"frame": frame or {"total_mass": 30.0}, "configuration": [state(**keys)], "prior": list(prior)}
    return Experiment.from_dict(declared)


def only(**keys):
    return experiment(**keys).configurations[0]


# The frame.


def test_frame_defaults():
    frame = experiment().frame
    assert (frame.stories, frame.total_mass, frame.gravity) == (3, 30.0, 9.81)
    assert frame.story_heights is None
    assert frame.floor_masses is None
    assert frame.elevations is None
    assert frame.known_total == 30.0


def test_one_story_height_is_every_storys():
    frame = experiment(frame={"total_mass": 30.0, "story_heights": 0.39}).frame
    assert_array_equal(frame.story_heights, [0.39, 0.39, 0.39])
    assert_allclose(frame.elevations, [0.39, 0.78, 1.17])
    frame = experiment(frame={"total_mass": 30.0, "story_heights": [4.0, 3.0, 2.0]}).frame
    assert_array_equal(frame.elevations, [4.0, 7.0, 9.0])


def test_known_floor_masses_give_the_total():
    frame = experiment(frame={"floor_masses": [12, 10, 8]}).frame
    assert_array_equal(frame.floor_masses, [12.0, 10.0, 8.0])
    assert frame.total_mass is None
    assert frame.known_total == 30.0


@pytest.mark.parametrize(
    ("frame", "keys"),
    [
        ({"stories": 4}, {"measured_floors": [1, 2, 3]}),
        ({"story_heights": [3.0, 3.0, 3.0, 3.0]}, {"measured_floors": [1, 2, 3]}),
        ({"floor_masses": [1.0, 1.0, 1.0, 1.0]}, {"measured_floors": [1, 2, 3]}),
        ({}, {"measured_floors": [1, 2, 3], "added_mass": [0, 0, 0, 2]}),
        ({}, {"measured_floors": [1, 2, 4]}),
        ({}, {"mode_shapes": [[1, 2, 3, 4], [1, 2, -3, -1], [1, -2, 1, -1]]}),
    ],
    ids=["stories", "story_heights", "floor_masses", "added_mass", "highest measured floor", "shapes at all floors"],
)
def test_the_number_of_stories_follows_from_any_part(frame, keys):
    whole = experiment(frame={"total_mass": 4.0, **frame}, **keys)
    assert whole.stories == whole.frame.stories == 4
    assert len(whole.configurations[0].added_mass) == 4


# The configuration.


def test_configuration_defaults():
    found = only()
    assert found.name == "configuration 1"
    assert_array_equal(found.added_mass, [0, 0, 0])
    assert_array_equal(found.measured_floors, [1, 2, 3])
    assert_array_equal(found.modes, [1, 2, 3])
    assert found.mass_normalized is False
    assert found.mode_shape_noise == "additive"
    assert found.frequency_std is None
    assert_array_equal(found.log_frequency_std, [0.002] * 3)
    assert found.mode_shape_std is None
    assert_array_equal(found.entry_std, np.full((3, 3), 0.01))
    assert found.damping_ratios is None
    assert found.noise_declared is False
    assert found.complete
    assert_array_equal(found.measured, np.ones((3, 3), bool))


def test_configurations_without_a_name_are_numbered():
    declared = {"configuration": [state(added_mass=[1, 0, 0]), state(name="B"), state()]}
    names = [each.name for each in Experiment.from_dict(declared).configurations]
    assert names == ["configuration 1", "B", "configuration 3"]


@pytest.mark.parametrize("std", [0.003, [0.003, 0.003, 0.003]])
def test_frequency_std_of_one_number_or_one_a_mode(std):
    found = only(frequency_std=std)
    assert_array_equal(found.frequency_std, [0.003] * 3)
    assert_array_equal(found.log_frequency_std, [0.003] * 3)


@pytest.mark.parametrize(
    ("std", "meant"),
    [
        (0.02, np.full((3, 3), 0.02)),
        ([0.01, 0.02, 0.03], [[0.01] * 3, [0.02] * 3, [0.03] * 3]),
        ([[0.01, 0.02, 0.03]] * 3, [[0.01, 0.02, 0.03]] * 3),
    ],
    ids=["one number", "one a mode", "one an entry"],
)
def test_mode_shape_std(std, meant):
    found = only(mode_shape_std=std)
    assert_array_equal(found.mode_shape_std, meant)
    assert_array_equal(found.entry_std, meant, err_msg="every row of these shapes has a largest entry of 1")


@pytest.mark.parametrize(
    ("kind", "meant"), [("additive", [0.08, 0.08, 0.08]), ("multiplicative", [0.02 * 1e-3 * 4.0, 0.04, 0.08])]
)
def test_noise_is_of_the_largest_entry_or_of_the_entry_itself(kind, meant):
    """A zero keeps a finite weight."""
    found = only(mode_shapes=[[0.0, 2.0, -4.0], *SHAPES[1:]], mode_shape_std=0.02, mode_shape_noise=kind)
    assert_allclose(found.entry_std[0], meant)


@pytest.mark.parametrize("kind", ["additive", "multiplicative"])
def test_nan_is_an_entry_that_was_not_measured(kind):
    found = only(
        mode_shapes=[[1.0, np.nan, -4.0], [-1.0, -0.3, 0.9], [np.nan, np.nan, 2.0]],
        mode_shape_std=0.02,
        mode_shape_noise=kind,
    )
    assert_array_equal(found.measured, [[True, False, True], [True] * 3, [False, False, True]])
    assert not found.complete
    assert_allclose(found.entry_std[0, 2], 0.08)
    assert_allclose(found.entry_std[2, 2], 0.04)
    assert np.all(found.entry_std[found.measured] > 0)


def test_two_modes_may_look_alike_where_floors_are_missing():
    """In a uniform frame of seven stories, the entries of modes 1 and 5 at floors 3 and 6 have the same ratio."""
    i, j = np.array([3, 6]), np.array([[1], [5]])
    shapes = np.sin((2 * j - 1) * np.pi * i / 15)
    assert_allclose(shapes[0, 1] / shapes[0, 0], shapes[1, 1] / shapes[1, 0])
    keys = {"frequencies": [1.0, 9.0], "modes": [1, 5], "measured_floors": [3, 6], "mode_shapes": shapes}
    found = experiment(frame={"total_mass": 7.0, "stories": 7}, **keys)
    assert_allclose(found.configurations[0].mode_shapes, shapes)


@pytest.mark.parametrize("scale", [1e-20, 1e20])
def test_a_shape_may_have_any_scale_and_sign(scale):
    found = only(mode_shapes=-scale * np.array(SHAPES))
    assert_allclose(found.mode_shapes, -scale * np.array(SHAPES))
    assert np.all(found.entry_std > 0)


# The mass scale of the frame.


@pytest.mark.parametrize(
    "declared",
    [
        {"frame": {"total_mass": 30.0}, "configuration": [state()]},
        {"frame": {"floor_masses": [10.0, 10.0, 10.0]}, "configuration": [state()]},
        {"configuration": [state(), state(added_mass=[0, 0, 5])]},
        {"configuration": [state(mass_normalized=True)]},
        {"configuration": [state()], "prior": [{"kind": "value", "quantity": "floor_mass", "at": 1, "value": 10.0}]},
        {"configuration": [state()], "prior": [NOMINAL]},
    ],
    ids=["total_mass", "floor_masses", "two added masses", "mass_normalized", "value", "nominal"],
)
def test_each_of_these_fixes_the_scale(declared):
    assert Experiment.from_dict(declared).stories == 3


# The experiment.


def test_with_priors_adds_to_its_own():
    first = {"kind": "monotone", "quantity": "story_stiffness", "direction": "decreasing"}
    second = Prior.from_dict({"kind": "bounds", "quantity": "floor_mass", "lower": 1.0})
    before = experiment(prior=[first])
    after = before.with_priors([second])
    assert after.priors == (*before.priors, second)
    assert len(before.priors) == 1
    assert before.with_priors([]) is before
    with pytest.raises(InputError, match=r"^prior 2: at of the value prior = 4 must lie between 1 and 3$"):
        before.with_priors([Prior.from_dict({"kind": "value", "quantity": "floor_mass", "at": 4, "value": 1})])


def test_noise_is_declared_only_where_every_configuration_declares_both():
    std = {"frequency_std": 0.001, "mode_shape_std": 0.01}
    assert only(**std).noise_declared
    assert not only(frequency_std=0.001).noise_declared
    assert not only(mode_shape_std=0.01).noise_declared
    declared = {"configuration": [state(**std), state(added_mass=[1, 0, 0])]}
    assert not Experiment.from_dict(declared).noise_declared
    declared["configuration"][1].update(std)
    assert Experiment.from_dict(declared).noise_declared


def rich():
    return {
        "frame": {"stories": 4, "story_heights": [4.0, 3.0, 3.0, 3.0], "total_mass": 40.0, "gravity": 9.8},
        "prior": [
            {"kind": "bounds", "quantity": "floor_mass", "lower": [1.0, 2.0, 3.0, 4.0], "upper": 100.0},
            {"kind": "ratio", "quantity": "floor_mass", "of": 2, "to": 1, "value": 1.5, "std": 0.02},
            {"kind": "value", "quantity": "story_stiffness", "at": 4, "value": 2e4},
            NOMINAL | {"values": [4e4, 4e4, 3e4, 2e4], "free_scale": True},
            {"kind": "monotone", "quantity": "story_stiffness", "direction": "decreasing"},
        ],
        "configuration": [
            {
                "name": "bare",
                "frequencies": [*FREQUENCIES],
                "mode_shapes": [[*SHAPES[0]], [np.nan, 1.0, -1.0], [np.nan] * 3],
                "measured_floors": [1, 3, 4],
                "modes": [1, 2, 4],
                "frequency_std": [0.001, 0.002, 0.003],
                "mode_shape_std": [[0.01, 0.02, 0.03]] * 3,
                "mode_shape_noise": "multiplicative",
                "damping_ratios": [0.01, 0.01, 0.02],
                "mass_normalized": True,
                "added_mass": [0.0, 0.0, 0.0, 0.0],
                "date": "2024-05-03",
                "temperature": -4.0,
                "amplitude": 0.02,
            },
            {"name": "loaded", "frequencies": [1.5], "mode_shapes": [[0.2, 0.5, 0.8, 1.0]], "added_mass": [5, 0, 0, 1]},
        ],
    }


def test_to_dict_gives_back_what_was_declared():
    declared = rich()
    found = Experiment.from_dict(declared).to_dict()
    np.testing.assert_equal(Experiment.from_dict(found).to_dict(), found)
    assert found["frame"] == declared["frame"]
    assert found["prior"] == declared["prior"] or found["prior"][3].pop("free_scale")
    for key, value in declared["configuration"][0].items():
        np.testing.assert_equal(found["configuration"][0][key], value, err_msg=key)


@pytest.mark.parametrize("said", ["2024-05-03", datetime.date(2024, 5, 3), "20240503"])
def test_a_date_is_one_of_toml_or_a_text(said):
    assert only(date=said).date[:10] == "2024-05-03"
    assert only(date=datetime.datetime(2024, 5, 3, 14, 30)).date == "2024-05-03T14:30:00"


def test_none_in_a_dict_is_a_key_not_given():
    keys = ["name", "added_mass", "measured_floors", "modes", "mass_normalized", "mode_shape_noise"]
    keys += ["frequency_std", "mode_shape_std", "damping_ratios"]
    frame = {"total_mass": 30.0, **dict.fromkeys(["stories", "story_heights", "gravity"])}
    found = experiment(frame=frame, **dict.fromkeys(keys))
    np.testing.assert_equal(found.to_dict(), experiment().to_dict())


# The experiment is frozen and read-only, and shares no arrays with the caller.


def test_frozen():
    whole = experiment()
    for item, name in ((whole, "frame"), (whole.frame, "stories"), (whole.configurations[0], "frequencies")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(item, name, None)


def test_every_array_is_read_only():
    whole = Experiment.from_dict(rich())
    arrays = [
        value
        for item in (whole.frame, *whole.configurations, *whole.priors)
        for value in vars(item).values()
        if isinstance(value, np.ndarray)
    ]
    assert len(arrays) > 10
    assert not any(array.flags.writeable for array in arrays)


def test_the_callers_arrays_are_copied():
    given = {
        "frequencies": np.array(FREQUENCIES),
        "mode_shapes": np.array(SHAPES),
        "added_mass": np.array([1.0, 0, 0]),
        "measured_floors": np.array([1, 2, 3]),
        "modes": np.array([1, 2, 3]),
        "frequency_std": np.full(3, 0.1),
        "mode_shape_std": np.full((3, 3), 0.1),
        "damping_ratios": np.full(3, 0.1),
    }
    frame = {"floor_masses": np.array([10.0, 10.0, 10.0]), "story_heights": np.array([3.0, 3.0, 3.0])}
    values = np.array([1.0, 2.0, 3.0])
    prior = Prior.from_dict({"kind": "nominal", "quantity": "floor_mass", "values": values})
    whole = Experiment(Frame(**frame), (Configuration(**given),), (prior,))
    kept = [*(getattr(whole.configurations[0], name) for name in given), *(getattr(whole.frame, n) for n in frame)]
    for mine, theirs in zip([*given.values(), *frame.values(), values], [*kept, prior.values], strict=True):
        assert mine.flags.writeable
        assert not np.shares_memory(mine, theirs)
        before = theirs.copy()
        np.add(mine, 1, out=mine)
        assert_array_equal(theirs, before)


# Built in Python, without a file.


def test_the_classes_take_arrays():
    bare = Configuration(np.array(FREQUENCIES), np.array(SHAPES), name="bare", frequency_std=np.float64(0.001))
    whole = Experiment(Frame(total_mass=np.float64(30.0), stories=np.int64(3)), [bare], name="mine")
    np.testing.assert_equal(whole.to_dict(), experiment(name="bare", frame={"total_mass": 30, "stories": 3},
                                                        frequency_std=0.001).to_dict())  # fmt: skip
    assert whole.name == "mine"
    assert isinstance(whole.configurations, tuple)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"frequencies": np.array([2.0, 5.0, np.nan])}, "frequencies, entry 3 must be a finite number, not nan"),
        ({"frequencies": np.array(FREQUENCIES).astype(str)}, "frequencies, entry 1 must be a number, not '2.0'"),
        ({"mode_shapes": np.array(SHAPES) * (1 + 1j)}, "mode_shapes, row 1, entry 1 must be a number, not (0.4+0.4j)"),
        ({"modes": np.array([1.0, 2.0, 3.0])}, "modes, entry 1 must be a whole number, not 1.0"),
        ({"mode_shape_std": np.ones((3, 2))}, "mode_shape_std has 2 entries a row, not 3"),
        ({"mass_normalized": np.array([True])}, "mass_normalized must be true or false, not [True]"),
    ],
)
def test_the_classes_check_like_from_dict(keys, message):
    for build in (lambda: Configuration(**state(**keys)), lambda: only(**keys)):
        with pytest.raises(InputError) as caught:
            build()
        assert message in str(caught.value)
        assert str(caught.value).startswith('configuration "configuration 1": ')


@pytest.mark.parametrize(
    ("key", "value"), [("mode_shape_std", 0.01), ("mode_shape_std", np.ones((3, 0))), ("measured_floors", [1])]
)
def test_what_concerns_shapes_needs_shapes(key, value):
    with pytest.raises(InputError, match=f"{key} is given, but no mode_shapes: leave it out, or give the shapes"):
        Configuration(FREQUENCIES, **{key: value})


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((None, ()), "frame must be a Frame, not None"),
        ((Frame(), ()), "at least one [[configuration]] is needed: none was found"),
        ((Frame(), 3), "configurations must be a sequence of Configuration, not 3"),
        ((Frame(), ({},)), "configurations, entry 1 must be a Configuration, not {}"),
        ((Frame(), (), ("bounds",)), "priors, entry 1 must be a Prior, not 'bounds'"),
        ((Frame(), (), (), ""), "name of the experiment must be a text that is not empty, not ''"),
    ],
)
def test_the_experiment_takes_only_its_own_parts(parts, message):
    with pytest.raises(InputError) as caught:
        Experiment(*parts)
    assert str(caught.value) == message


# The built-in files.


def test_the_papers_frame():
    """Compare with the printed Tables 4 and 5, net total mass, story height, and the ratios of Fig. 8."""
    paper = load("paper")
    assert paper.name == "paper"
    assert paper.stories == 2
    assert paper.frame.total_mass == 31.33
    assert_array_equal(paper.frame.story_heights, [0.39, 0.39])
    assert [each.name for each in paper.configurations] == ["Structure 1", "Structure 2", "Structure 3"]
    assert_array_equal([each.added_mass for each in paper.configurations], [[13.5, 8.6], [27.5, 22.6], [41.0, 36.1]])
    assert_array_equal(
        [each.frequencies for each in paper.configurations], [[2.990, 7.934], [2.380, 6.331], [2.030, 5.420]]
    )
    ratios = [each.mode_shapes[:, 0] / each.mode_shapes[:, 1] for each in paper.configurations]
    assert_array_equal(ratios, [[0.61071, -1.65840], [0.60400, -1.69489], [0.61081, -1.66671]])
    assert all(each.complete for each in paper.configurations)
    assert not paper.noise_declared
    assert paper.priors == ()


def test_the_example_is_the_built_in_file():
    packaged = Path(cvxshear.__file__).parent / "paper" / "paper.toml"
    assert (EXAMPLES / "paper.toml").read_bytes() == packaged.read_bytes()


@pytest.mark.parametrize("file", MEASURED, ids=lambda file: file.name)
def test_every_example_with_a_configuration_is_a_measurement_file(file):
    found = load(file)
    assert found.name == file.stem
    assert len(found.configurations) == len(tomllib.loads(file.read_text())["configuration"])


@pytest.mark.parametrize("file", DESIGNS, ids=lambda file: file.name)
def test_every_example_without_a_configuration_is_a_design_file(file):
    """Such a file has no measurement yet: planning accepts it, identification refuses it."""
    declared = tomllib.loads(file.read_text())
    values = {prior["quantity"]: prior["values"] for prior in declared["prior"]}
    design = read_design(file)
    assert design.name == file.stem
    assert design.measured is None
    assert_array_equal(design.floor_mass, values["floor_mass"])
    assert_array_equal(design.story_stiffness, values["story_stiffness"])
    assert_array_equal(design.frame.story_heights, declared["frame"]["story_heights"])
    with pytest.raises(InputError, match=r"at least one \[\[configuration\]\] is needed"):
        load(file)


def test_a_file_may_start_with_a_byte_order_mark(tmp_path):
    file = tmp_path / "windows.toml"
    file.write_bytes(b"\xef\xbb\xbf" + (EXAMPLES / "paper.toml").read_bytes().replace(b"\n", b"\r\n"))
    assert load(str(file)).stories == 2


def test_a_file_named_paper_is_reached_with_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "paper").write_bytes((EXAMPLES / "three_story.toml").read_bytes())
    assert load("./paper").stories == 3
    assert load(Path("paper")).stories == 3
    assert load("paper").stories == 2


# The reference page.

PAGE = (EXAMPLES.parent / "docs" / "measurement-file.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```toml\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("text", BLOCKS)
def test_every_example_of_the_reference_is_a_measurement_file(text, tmp_path):
    file = tmp_path / "frame.toml"
    file.write_text(text)
    assert load(file).stories >= 2


def test_the_reference_names_every_key():
    assert len(BLOCKS) >= 4
    for item in (Frame, Configuration, *(Prior.kinds[kind] for kind in ("bounds", "ratio", "value", "nominal"))):
        for key in dataclasses.fields(item):
            assert f"`{key.name}`" in PAGE
    for kind in ("bounds", "ratio", "value", "nominal", "monotone"):
        assert f"| `{kind}` |" in PAGE
