"""Check the printed figures against each other, to find errors of copying."""

import numpy as np
import pytest

from cvxshear.paper.tables import PRINTED, decimals, value, values

TRUTH_MASS, TRUTH_STIFFNESS = np.array([10.0, 7.5, 5.0]), np.array([1.8, 1.2, 0.6])
STRUCTURES = list(PRINTED["table_4"])


def of(table, name):
    return values(PRINTED[table][name])


@pytest.mark.parametrize("name", STRUCTURES)
def test_net_mass_is_mass_less_counterweight_and_adds_up(name):
    net = of("table_6_net_mass", name)
    np.testing.assert_allclose(of("table_6_mass", name) - of("table_4", name), net, atol=1e-9)
    assert sum(net) == pytest.approx(value(PRINTED["conclusions"]["total_net_mass"]), abs=1e-9)


@pytest.mark.parametrize("name", STRUCTURES)
def test_table_8_follows_from_tables_5_and_7(name):
    errors = 100 * (of("table_7", name) / of("table_5", name) - 1)
    np.testing.assert_allclose(errors, of("table_8", name), atol=5.01e-4)


@pytest.mark.parametrize("case", ["1", "2"])
@pytest.mark.parametrize("method", PRINTED["largest_errors"])
def test_the_errors_in_the_text_follow_from_tables_1_and_2(method, case):
    mass = [value(PRINTED["table_1"][method][case][entry]) for entry in ("11", "22", "33")]
    stiffness = values(PRINTED["table_2"][method][case])
    errors = [np.max(np.abs(mass / TRUTH_MASS - 1)), np.max(np.abs(stiffness / TRUTH_STIFFNESS - 1))]
    np.testing.assert_allclose(100 * np.array(errors), values(PRINTED["largest_errors"][method][case]), atol=5.01e-3)


def test_the_differences_between_the_structures():
    for table, key in (("table_6_net_mass", "net_mass"), ("table_6_stiffness", "stiffness")):
        found = np.array([of(table, name) for name in STRUCTURES])
        largest = 100 * np.max(1 - found.min(axis=0) / found.max(axis=0))
        assert largest == pytest.approx(value(PRINTED["conclusions"][key]), abs=5.01e-3)


def test_the_initial_masses_add_up_to_the_frames():
    assert [sum(start) for start in PRINTED["initial_mass"].values()] == [22.5, 22.5]


def test_a_printed_figure_knows_its_decimals():
    assert [decimals(text) for text in ("10", "7.5", "-0.004", "3.030")] == [0, 1, 3, 3]
    assert value("about 5") == 5.0
