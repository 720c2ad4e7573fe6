"""Test invalid measurement files and the library's message about each.

A message names the place, the wrong value and the remedy, so each case gives the whole message.
"""

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, seed, settings
from hypothesis import strategies as st

from cvxshear.io import toml
from cvxshear.io.toml import load
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.errors import CvxshearError, InputError
from tests.measurement.test_experiment import rich

FREQUENCIES = [2.0, 5.0]
SHAPES = [[0.6, 1.0], [-1.7, 1.0]]
ABSENT = object()
HUGE = 10**400
TOO_LONG = 10**5000
"""A whole number that Python refuses to print."""

BOUNDS = {"kind": "bounds", "quantity": "floor_mass", "lower": 1.0, "upper": 9.0}
RATIO = {"kind": "ratio", "quantity": "floor_mass", "of": 2, "to": 1, "value": 1.5, "std": 0.02}
VALUE = {"kind": "value", "quantity": "story_stiffness", "at": 1, "value": 2e4}
NOMINAL = {"kind": "nominal", "quantity": "story_stiffness", "values": [2e4, 1e4], "std": 0.1}
MONOTONE = {"kind": "monotone", "quantity": "story_stiffness", "direction": "decreasing"}


def changed(table, keys):
    """Return the table with some keys replaced or added. A key with the value ABSENT is left out."""
    return {key: value for key, value in {**table, **keys}.items() if value is not ABSENT}


def declared(*, frame=None, priors=ABSENT, configurations=None, **keys):
    """Return a sound two-story file with the given changes."""
    sound = {"name": "A", "frequencies": FREQUENCIES, "mode_shapes": SHAPES}
    states = [changed(sound, keys)] if configurations is None else [changed(sound, each) for each in configurations]
    return changed({"frame": changed({"total_mass": 30.0}, frame or {}), "configuration": states}, {"prior": priors})


def test_the_sound_file_is_sound(tmp_path):
    """The file without changes is sound. Otherwise another fault could cause the refusals below."""
    priors = [BOUNDS, RATIO, VALUE, NOMINAL, MONOTONE]
    assert Experiment.from_dict(declared(priors=priors)).stories == 2
    (tmp_path / "frame.toml").write_text(SOUND)
    assert load(tmp_path / "frame.toml").name == "frame"


def refused(table):
    with pytest.raises(InputError) as caught:
        Experiment.from_dict(table)
    return str(caught.value)


# The tables of the file.

TABLES_OF_A_FILE = "known keys are configuration, damping, effect, frame, limits, prior, report, static"
TABLES = [
    ({"frame": {}}, "at least one [[configuration]] is needed: none was found"),
    ({"prior": [{"kind": "nominal", "quantity": "floor_mass", "values": [1.0]}]},
     "at least one [[configuration]] is needed: none was found; "
     "a file of design values, before any test, is for cvxshear plan"),
    ({}, "at least one [[configuration]] is needed: none was found"),
    ([1], "the measurement file must be a table of keys and values, not [1]"),
    (None, "the measurement file must be a table of keys and values, not None"),
    ({"configurations": []}, "the measurement file: unknown key 'configurations'; did you mean 'configuration'?"),
    ({**declared(), "total_mass": 3.0}, "the measurement file: unknown key 'total_mass'; it belongs in [frame]"),
    ({**declared(), "zzz": 1}, f"the measurement file: unknown key 'zzz'; {TABLES_OF_A_FILE}"),
    ({**declared(), 3: 1}, f"the measurement file: unknown key 3; {TABLES_OF_A_FILE}"),
    ({"configuration": declared()["configuration"][0]},
     "[configuration] must be a list of tables: write [[configuration]], in double brackets"),
    ({"configuration": 3}, "configuration must be a list of tables, each below [[configuration]], not 3"),
    ({"configuration": [3]}, "configuration 1 must be a table of keys and values, not 3"),
    ({**declared(), "frame": [{"stories": 2}]},
     "[frame] must be one table, in single brackets, not a list: [{'stories': 2}]"),
    ({**declared(), "prior": BOUNDS}, "[prior] must be a list of tables: write [[prior]], in double brackets"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "message"), TABLES)
def test_tables(table, message):
    assert refused(table) == message


# The frame.

FRAMES = [
    ({"total_mas": 3.0}, "unknown key 'total_mas'; did you mean 'total_mass'?"),
    ({"frequencies": [1.0]}, "unknown key 'frequencies'; it belongs in [[configuration]]"),
    ({"stories": 1000000}, "stories = 1000000 must lie between 1 and 2000"),
    ({"stories": HUGE}, f"stories = 1{'0' * 27}...{'0' * 29} must lie between 1 and 2000"),
    ({"stories": TOO_LONG}, "stories = a number too long to print must lie between 1 and 2000"),
    ({"stories": "2"}, "stories must be a whole number, not '2'"),
    ({"stories": True}, "stories must be a whole number, not True"),
    ({"total_mass": -3}, "total_mass = -3 must be greater than 0"),
    ({"total_mass": "31 kg"}, "total_mass must be a number, not '31 kg'"),
    ({"total_mass": HUGE}, f"total_mass = 1{'0' * 27}...{'0' * 29} must be between 1e-30 and 1e+30; check its unit"),
    ({"floor_masses": 15.0}, "floor_masses must be a list of numbers, not 15.0"),
    ({"floor_masses": [15.0, 0.0]}, "floor_masses, entry 2 = 0 must be greater than 0"),
    ({"floor_masses": [15.0, 16.0]},
     "floor_masses add up to 31 kg, total_mass says 30 kg; give one of the two, or values that agree"),
    ({"story_heights": 0}, "story_heights = 0 must be greater than 0"),
    ({"story_heights": [3.0, -3.0]}, "story_heights, entry 2 = -3 must be greater than 0"),
]  # fmt: skip


@pytest.mark.parametrize(("frame", "message"), FRAMES)
def test_frame(frame, message):
    assert refused(declared(frame=frame)) == f"frame: {message}"


# One configuration.

KEYS = [
    ({"frequencies": ABSENT}, ": the key 'frequencies' is missing"),
    ({"frequencis": 1, "frequencies": ABSENT}, ": unknown key 'frequencis'; did you mean 'frequencies'?"),
    ({"total_mass": 30.0}, ": unknown key 'total_mass'; it belongs in [frame]"),
    ({"frequencies": 2.0}, ": frequencies must be a list of numbers, not 2.0"),
    ({"frequencies": [2.0, "5 Hz"]}, ": frequencies, entry 2 must be a number, not '5 Hz'"),
    ({"frequencies": [2.0, np.nan]}, ": frequencies, entry 2 must be a finite number, not nan"),
    ({"frequencies": [0.0, 2.0]}, ": frequencies, entry 1 = 0 must be greater than 0"),
    ({"frequencies": [5.0, 2.0]},
     ": frequencies must be ascending, each greater than the one before; entry 2 is 2 Hz after 5 Hz "
     "(sort the mode shapes with them)"),
    ({"frequencies": [2.0, 5.0, 7.0]}, ": mode_shapes must have 3 rows, one for each frequency, not 2"),
    ({"mode_shapes": [[0.3, -1.7], [0.6, 0.2], [1.0, 1.0]]},
     ": mode_shapes must have 2 rows, one for each frequency, not 3: a row is a mode, not a floor"),
    ({"mode_shapes": "x"}, ": mode_shapes must be a list of lists of numbers, one a mode, not 'x'"),
    ({"mode_shapes": [[0.6, 1.0], [1.0]]}, ": mode_shapes, row 2 has 1 entry, row 1 has 2: give one a measured floor"),
    ({"mode_shapes": [[0.6, "1.0"], [-1.7, 1.0]]}, ": mode_shapes, row 1, entry 2 must be a number, not '1.0'"),
    ({"mode_shapes": [[0.6, 1.0], [0.0, 0.0]]},
     ": mode_shapes, row 2 is zero at every measured floor; write nan where nothing was measured"),
    ({"mode_shapes": [[0.6, 1.0], [np.nan, 0.0]]},
     ": mode_shapes, row 2 is zero at every measured floor; write nan where nothing was measured"),
    ({"mode_shapes": [[0.6, 1.0], [0.6, 1.0]]},
     ": mode_shapes, rows 1 and 2 are the same shape; each mode has its own"),
    ({"mode_shapes": [[0.6, 1.0], [-1.2e9, -2.0e9]]},
     ": mode_shapes, rows 1 and 2 are the same shape; each mode has its own"),
    ({"frequencies": [2.0, 3.0, 4.0], "mode_shapes": [[1, 2, 3], [1, -1, 1], [1, 2, 3]], "measured_floors": [1, 2, 9]},
     ": mode_shapes, rows 1 and 3 are the same shape; each mode has its own"),
    ({"measured_floors": [0, 1]}, ": measured_floors, entry 1 = 0 must lie between 1 and 2000"),
    ({"measured_floors": [2, 1]}, ": measured_floors must be ascending, none twice; found 1 after 2"),
    ({"measured_floors": [1, 3], "added_mass": [0, 1]},
     ": measured_floors names floor 3 of a frame of 2 stories; floors count from 1, the first above ground, to 2"),
    ({"measured_floors": [1, 2, 3]},
     ": measured_floors must have 2 entries, one an entry in each row of mode_shapes, not 3"),
    ({"measured_floors": []}, ": measured_floors must not be empty; leave the key out for its default"),
    ({"modes": [1, 2, 3]}, ": modes must have 2 entries, one a frequency, not 3"),
    ({"modes": [1, 3]},
     ": modes names mode 3 (where not given: 1 to 2, the number of frequencies), a frame of 2 stories has 2; leave "
     "out what is not a sway mode, or give the right number of stories"),
    ({"added_mass": [1.0, -1.0]}, ": added_mass, entry 2 = -1 must not be less than 0"),
    ({"mass_normalized": "yes"}, ": mass_normalized must be true or false, not 'yes'"),
    ({"frequency_std": 0.0}, ": frequency_std = 0 must be greater than 0"),
    ({"frequency_std": [0.1]}, ": frequency_std must have 2 entries, one a mode, not 1"),
    ({"mode_shape_std": [[0.1, 0.1]]},
     ": mode_shape_std must have 2 rows, one for each frequency, not 1: a row is a mode, not a floor"),
    ({"mode_shape_std": [[0.1] * 3] * 2}, ": mode_shape_std has 3 entries a row, not 2"),
    ({"mode_shape_std": [[0.1, 0.1], [0.1, 0]]}, ": mode_shape_std, row 2, entry 2 = 0 must be greater than 0"),
    ({"mode_shape_noise": "Additiv"},
     ": mode_shape_noise must be one of additive, multiplicative, not 'Additiv'; did you mean 'additive'?"),
    ({"damping_ratios": [0.01, 1.0]}, ": damping_ratios must be below 1 (a fraction of critical, not percent), not 1"),
    ({"date": "May 2024"}, ": date must be a date such as 2024-05-03, not 'May 2024'"),
    ({"amplitude": 0.0}, ": amplitude = 0 must be greater than 0"),
    ({"damping_ratios": -0.01}, ": damping_ratios = -0.01 must not be less than 0"),
    ({"damping_ratios": [0.01]}, ": damping_ratios must have 2 entries, one a mode, not 1"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "message"), KEYS)
def test_configuration(keys, message):
    assert refused(declared(**keys)) == f'configuration "A"{message}'


@pytest.mark.parametrize(("name", "found"), [(3, "3"), ("", "''"), ("  ", "'  '"), (["A"], "['A']")])
def test_a_name_that_is_none(name, found):
    assert refused(declared(name=name)) == f"configuration 1: name must be a text that is not empty, not {found}"


# Parts that do not fit each other.

CONTRADICTIONS = [
    ({"frame": {"stories": 3}},
     'configuration "A": mode_shapes (no measured_floors given) speaks of 2 stories, frame: stories of 3; '
     "they must agree"),
    ({"frame": {"stories": 2, "story_heights": [3.0]}},
     "frame: story_heights speaks of 1 stories, frame: stories of 2; they must agree"),
    ({"configurations": [{}, {"name": "B", "mode_shapes": [[1, 2, 3], [1, 2, -3]]}]},
     'configuration "B": mode_shapes (no measured_floors given) speaks of 3 stories, configuration "A": mode_shapes '
     "(no measured_floors given) of 2; they must agree"),
    ({"configurations": [{}, {}]}, 'two configurations are named "A"; give each a name of its own'),
    ({"added_mass": [0.0] * 2001, "measured_floors": [1, 2]},
     'configuration "A": added_mass speaks of 2001 stories; 2000 are the most that are taken'),
    ({"configurations": [{}, {"name": "B", "measured_floors": [2, 3]}]},
     'configuration "B": measured_floors names floor 3 of a frame of 2 stories; floors count from 1, the first '
     "above ground, to 2"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), CONTRADICTIONS)
def test_contradictions(changes, message):
    assert refused(declared(**changes)) == message


def test_frequencies_alone_do_not_tell_how_many_stories_there_are():
    table = {"frame": {"total_mass": 3.0}, "configuration": [{"frequencies": [1.0, 2.0]}]}
    assert refused(table) == "nothing tells how many stories the frame has; give frame: stories"


NO_SCALE = (
    "nothing tells how heavy the frame is: give frame: total_mass or floor_masses, two configurations with different "
    "added_mass, mass_normalized shapes, a static test, or a prior that fixes the scale (value, or nominal without "
    "free_scale)"
)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"configurations": [{"added_mass": [1, 2]}, {"name": "B", "added_mass": [1, 2]}]},
        {"priors": [BOUNDS, RATIO, MONOTONE, {**NOMINAL, "free_scale": True}]},
        {"mode_shapes": [[np.nan] * 2] * 2, "mass_normalized": True},
    ],
    ids=["nothing", "the same added mass twice", "priors without scale", "mass-normalized shapes that nobody measured"],
)
def test_no_mass_scale(changes):
    assert refused(declared(frame={"total_mass": ABSENT}, **changes)) == NO_SCALE


# Priors.

PRIORS = [
    ("bounds", "a prior must be a table of keys and values, not 'bounds'"),
    ({}, "the key 'kind' is missing; it is one of {kinds}"),
    ({"kind": "bound"}, "kind must be one of {kinds}, not 'bound'; did you mean 'bounds'?"),
    ({**BOUNDS, "lowr": 1}, "the bounds prior: unknown key 'lowr'; did you mean 'lower'?"),
    ({**MONOTONE, "free_scale": True},
     "the monotone prior: unknown key 'free_scale'; known keys are direction, kind, quantity"),
    ({"kind": "value", "quantity": "floor_mass", "at": 1}, "the value prior: the key 'value' is missing"),
    ({**BOUNDS, "quantity": "floor_masses"},
     "quantity of the bounds prior must be one of floor_mass, story_stiffness, not 'floor_masses'; "
     "did you mean 'floor_mass'?"),
    ({"kind": "bounds", "quantity": "floor_mass"}, "the bounds prior needs a key 'lower' or 'upper'"),
    ({**BOUNDS, "lower": [1.0, 10.0]}, "the bounds prior on floor_mass 2: lower 10 is above upper 9; it must not be"),
    ({**BOUNDS, "lower": -1}, "lower of the bounds prior = -1 must not be less than 0"),
    ({**BOUNDS, "upper": 0}, "upper of the bounds prior = 0 must be greater than 0"),
    ({**BOUNDS, "upper": [9, 9, 9]},
     "upper of the bounds prior has 3 entries, the frame has 2 stories; give one number for all, or one a story"),
    ({**RATIO, "of": 0}, "of of the ratio prior = 0 must lie between 1 and 2000"),
    ({**RATIO, "to": 3}, "to of the ratio prior = 3 must lie between 1 and 2"),
    ({**RATIO, "to": 2}, "the ratio prior compares floor_mass 2 with itself; 'of' and 'to' must differ"),
    ({**RATIO, "value": 0}, "value of the ratio prior = 0 must be greater than 0"),
    ({**RATIO, "std": 0.0}, "std of the ratio prior = 0 must be greater than 0"),
    ({**VALUE, "at": 3}, "at of the value prior = 3 must lie between 1 and 2"),
    ({**VALUE, "value": -2e4}, "value of the value prior = -20000 must be greater than 0"),
    ({**NOMINAL, "values": [1, 2, 3]},
     "values of the nominal prior has 3 entries, the frame has 2 stories; give one a story"),
    ({**NOMINAL, "values": [2e4, 0]}, "values of the nominal prior, entry 2 = 0 must be greater than 0"),
    ({**NOMINAL, "free_scale": "true"}, "free_scale of the nominal prior must be true or false, not 'true'"),
    ({**MONOTONE, "direction": "decrease"},
     "direction of the monotone prior must be one of decreasing, increasing, not 'decrease'; "
     "did you mean 'decreasing'?"),
]  # fmt: skip


@pytest.mark.parametrize(("prior", "message"), PRIORS)
def test_prior(prior, message):
    kinds = "value, nominal, ratio, bounds, monotone"
    found = refused(declared(priors=[MONOTONE, prior]))
    assert found.startswith("prior 2: ")
    # A custom prior that another test registers adds its kind to the list.
    assert found.removeprefix("prior 2: ").replace(", test-smooth", "") == message.replace("{kinds}", kinds)


# Files.

SOUND = """\
[frame]
total_mass = 31.33

[[configuration]]
name = "A"
frequencies = [2.990, 7.934]
mode_shapes = [[0.61071, 1.0], [-1.65840, 1.0]]
"""

FILES = [
    (b"", ": at least one [[configuration]] is needed: none was found"),
    (b"total mass: 31.33\n", " is not valid TOML: Expected '=' after a key in a key/value pair (at line 1, column 7)"),
    (b"[frame]\n[frame]\n", " is not valid TOML: Cannot declare ('frame',) twice (at line 2, column 7)"),
    (SOUND.replace("31.33", "31,33").encode(),
     " is not valid TOML: Expected newline or end of document after a statement (at line 2, column 16)"),
    (b"\x89PNG\r\n\x1a\n\x00\x00", " is not UTF-8 text (byte 0); is it a TOML file, saved as UTF-8?"),
    (b'[[configuration]]\nname = "Geb\xe4ude"\n', " is not UTF-8 text (byte 29); is it a TOML file, saved as UTF-8?"),
    (SOUND.encode() + b'[[effect]]\nname = "wall"\nfloor = 1\n',
     ": effect wall: floor = 1 is no place of it; one is: the whole frame"),
    (b"x = " + b"[" * 50_000, " is not valid TOML: maximum recursion depth exceeded"),
    (b"[frame]\nstories = " + b"9" * 5000,
     " is not valid TOML: Exceeds the limit (4300 digits) for integer string conversion: value has 5000 digits; use "
     "sys.set_int_max_str_digits() to increase the limit"),
    (SOUND.replace("7.934", "-7.934").encode(),
     ': configuration "A": frequencies, entry 2 = -7.934 must be greater than 0'),
]  # fmt: skip


def refused_file(path):
    with pytest.raises(InputError) as caught:
        load(path)
    return str(caught.value)


@pytest.mark.parametrize(("content", "message"), FILES, ids=[message for _, message in FILES])
def test_file(content, message, tmp_path):
    file = tmp_path / "frame.toml"
    file.write_bytes(content)
    assert refused_file(file) == f"{file}{message}"


def test_a_file_that_is_not_there(tmp_path):
    file = tmp_path / "missing.toml"
    message = refused_file(file)
    assert message.startswith(f"{file}: no such file (the built-in examples are called paper, los-alamos, ")


def test_what_is_no_file_is_refused(tmp_path):
    (tmp_path / "file").write_text(SOUND)
    inside, long = tmp_path / "file" / "frame.toml", "x" * 5000
    assert refused_file(tmp_path) == f"{tmp_path} is a folder; name a file in it"
    assert refused_file(inside) == f"{inside} cannot be read: Not a directory"
    assert refused_file(long) == f"{long} cannot be read: File name too long"
    assert refused_file("a\0b.toml") == r"a\x00b.toml cannot be read: embedded null byte"
    assert refused_file({}) == (
        "load takes the name of a measurement file, not {}; a dict goes to Experiment.from_dict"
    )


def test_an_unreadable_file(tmp_path, monkeypatch):
    """The test simulates the refusal, because a superuser can read every file."""
    file = tmp_path / "frame.toml"
    file.write_text(SOUND)

    def refuse(*_):
        raise PermissionError(13, "Permission denied", str(file))

    monkeypatch.setattr(toml.Path, "open", refuse)
    assert refused_file(file) == f"{file} cannot be read: Permission denied"


def test_a_file_too_large(tmp_path, monkeypatch):
    monkeypatch.setattr(toml, "LARGEST_FILE", 2_000_000)
    file = tmp_path / "record.toml"
    file.write_bytes(b"#" * 2_000_001)
    assert refused_file(file) == f"{file} has more than 2 MB; too many for a measurement file"


# Anything else.


def places(value, path=()):
    """Return every place in the nested value, starting with the whole value."""
    yield path
    for key, item in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(item, (*path, key))


def put(value, path, junk):
    if not path:
        return junk
    *way, last = path
    table = value
    for key in way:
        table = table[key]
    table[last] = junk
    return value


def nested(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


PLACES = list(places(rich()))
"""Every place in a file that uses every key; `test_experiment` reads it."""
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from(["HUGE", "-HUGE", "TOO_LONG"]).map(lambda name: {"HUGE": HUGE, "-HUGE": -HUGE}.get(name, TOO_LONG)),
    st.floats(),
    st.sampled_from([5e-324, 1e-320, 1e-160, 1e-29, 1e29, 1e160, 1.7e308, 0.0, -0.0]),
    st.text(max_size=5),
    st.binary(max_size=3),
    st.complex_numbers(),
    st.datetimes(),
    st.times(),
    st.sampled_from(
        [np.float32(1.5), np.int8(1), np.array(2.0), np.array([]), np.array([[1.0]]), np.array(["x"]), object]
    ),
)
JUNK = st.one_of(
    st.recursive(
        SCALARS,
        lambda inner: st.one_of(
            st.lists(inner, max_size=3),
            st.tuples(inner, inner),
            st.dictionaries(st.one_of(st.text(max_size=3), st.integers(), st.none()), inner, max_size=2),
        ),
        max_leaves=6,
    ),
    st.sampled_from([["x"] * 1000, "x" * 1000, range(3), {1, 2}, b"\xff" * 1000]),
)


@pytest.mark.parametrize("path", PLACES, ids=str)
def test_no_depth_is_too_much_to_refuse(path):
    assert refused(put(rich(), path, nested(5000)))


@seed(1)
@settings(max_examples=500, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.sampled_from(PLACES), JUNK)
@example(("frame", "stories"), np.array([1, 2]))
@example(("configuration", 0, "mode_shapes"), [[1e160, 1e160], [1e160, -1e160]])
@example(("configuration", 0, "added_mass"), [[1], [1, 2]])
@example(("configuration", 0, "mode_shapes"), None)
@example(("configuration", 1, "mode_shapes"), None)
@example(("frame", "floor_masses"), [1.7e308, 1.7e308])
def test_junk_is_taken_or_refused(path, junk):
    """If one value is replaced by junk, the file is either a valid experiment or refused with one message."""
    try:
        found = Experiment.from_dict(put(rich(), path, junk))
    except InputError as error:
        assert str(error)  # noqa: PT017
        assert len(str(error)) < 600  # noqa: PT017
    else:
        again = Experiment.from_dict(found.to_dict())
        np.testing.assert_equal(again.to_dict(), found.to_dict())


@seed(2)
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.binary(max_size=40), st.integers(0, len(SOUND)), st.integers(0, 30))
def test_a_damaged_file_is_taken_or_refused(tmp_path, junk, place, lost):
    file = tmp_path / "frame.toml"
    text = SOUND.encode()
    file.write_bytes(text[:place] + junk + text[place + lost :])
    try:
        load(file)
    except CvxshearError as error:
        assert isinstance(error, InputError)  # noqa: PT017
        assert str(error).startswith(str(file))  # noqa: PT017
