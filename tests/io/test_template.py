"""Compare the template of a measurement file with the page that lists every key."""

import re
import tomllib
from collections import Counter
from pathlib import Path

import pytest

import cvxshear
from cvxshear.io.templates import template

PAGE = (Path(__file__).parents[2] / "docs/measurement-file.md").read_text(encoding="utf-8")
TABLES = ("frame", "configuration", "static", "effect", "damping")
EXCLUSIVE = (
    "csv", "xlsx", "uff", "modes", "other_modes", "mass_normalized", "exclude", "total_mass_std",
    "total_mass_placeholder", "repeats", "frequency_covariance",
)  # fmt: skip
"""Keys that replace others, or that need other modes than those in the file."""


def keys_of_the_page(table):
    """Return the keys in the first column of a table's section, in their order."""
    section = re.split(r"^## ", PAGE, flags=re.MULTILINE)
    (found,) = (part for part in section if re.match(rf"`\[+{table}\]+`", part))
    rows = re.findall(r"^\| (`.*?) \|", found, flags=re.MULTILINE)
    return [key for row in rows for key in re.findall(r"`(\w+)`", row)]


def in_use(text, left_out=()):
    """Return the template with its commented keys activated."""
    lines = [re.sub(r"^# (?=\[+\w+\]+|\w+ = )", "", line) for line in text.splitlines()]
    return "\n".join(line for line in lines if line.partition(" = ")[0] not in left_out)


@pytest.mark.parametrize("table", TABLES)
def test_a_key_stands_once_on_the_page(table):
    counted = Counter(keys_of_the_page(table))
    assert counted
    assert set(counted.values()) == {1}


@pytest.mark.parametrize("table", TABLES)
def test_every_key_of_the_page_is_in_the_file_to_fill_in(table):
    found = tomllib.loads(in_use(template(3)))[table]
    present = set().union(*(found if isinstance(found, list) else [found]))
    assert set(keys_of_the_page(table)) <= present


@pytest.mark.parametrize("stories", [1, 3])
def test_what_is_commented_out_is_right_as_it_stands(stories, tmp_path):
    path = tmp_path / "all.toml"
    path.write_text(in_use(template(stories), EXCLUSIVE))
    found = cvxshear.load(path)
    assert found.frame.accept
    assert found.damping is not None
    assert len(found.to_dict()["static"]) == 1
    assert len(found.expected) == 3


def test_nothing_that_is_optional_is_read():
    text = template(3)
    assert max(map(len, text.splitlines())) <= 120
    assert set(tomllib.loads(text)) == {"frame", "configuration"}
