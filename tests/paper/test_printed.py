"""Check the printed figures against each other, to find errors of copying."""

import numpy as np
import pytest

from cvxshear.paper import tables
from cvxshear.paper.tables import decimals, value, values

TRUTH_MASS, TRUTH_STIFFNESS = np.array([10.0, 7.5, 5.0]), np.array([1.8, 1.2, 0.6])


@pytest.mark.parametrize("name", tables.STRUCTURES)
def test_net_mass_is_mass_less_counterweight_and_adds_up(name):
    mass, net, added = (values(table[name]) for table in (tables.TABLE_6_MASS, tables.TABLE_6_NET_MASS, tables.TABLE_4))
    np.testing.assert_allclose(np.subtract(mass, added), net, atol=1e-9)
    assert sum(net) == pytest.approx(value(tables.TOTAL_NET_MASS), abs=1e-9)


@pytest.mark.parametrize("name", tables.STRUCTURES)
def test_table_8_follows_from_tables_5_and_7(name):
    analytical, measured = np.array(values(tables.TABLE_7[name])), np.array(values(tables.TABLE_5[name]))
    np.testing.assert_allclose(100 * (analytical / measured - 1), values(tables.TABLE_8[name]), atol=5.01e-4)


@pytest.mark.parametrize(("key", "printed"), tables.LARGEST_ERRORS.items())
def test_the_errors_in_the_text_follow_from_tables_1_and_2(key, printed):
    mass = [value(tables.TABLE_1[key][i, i]) for i in (1, 2, 3)]
    errors = [np.max(np.abs(mass / TRUTH_MASS - 1)), np.max(np.abs(values(tables.TABLE_2[key]) / TRUTH_STIFFNESS - 1))]
    np.testing.assert_allclose(100 * np.array(errors), values(printed), atol=5.01e-3)


def test_the_differences_between_the_structures():
    net = np.array([values(tables.TABLE_6_NET_MASS[name]) for name in tables.STRUCTURES])
    stiffness = np.array([values(tables.TABLE_6_STIFFNESS[name]) for name in tables.STRUCTURES])
    for table, printed in ((net, tables.NET_MASS_DIFFERENCE), (stiffness, tables.STIFFNESS_DIFFERENCE)):
        assert 100 * np.max(1 - table.min(axis=0) / table.max(axis=0)) == pytest.approx(value(printed), abs=5.01e-3)


def test_the_initial_masses_add_up_to_the_frames():
    assert [sum(start) for start in tables.INITIAL_MASS.values()] == [22.5, 22.5]


def test_a_printed_figure_knows_its_decimals():
    assert [decimals(text) for text in ("10", "7.5", "-0.004", "3.030")] == [0, 1, 3, 3]
    assert value("about 5") == 5.0
