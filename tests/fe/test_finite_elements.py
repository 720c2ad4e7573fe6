"""Compare the finite-element frame with formulas of structural mechanics."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import linalg

from tests.fe.elements import Section
from tests.fe.frame import Building, assemble, sway_modes
from tests.fe.model import Model, Node


def upright(section, length, pieces, compression=0.0):
    """Return a column clamped at its foot; its nodes sway, stretch and turn."""
    model = Model()
    nodes = [Node(0.0, 0.0, {}, {}, {})]
    for part in range(1, pieces + 1):
        motions = [{(kind, part): 1.0} for kind in ("sway", "rise", "turn")]
        nodes.append(Node(0.0, length * part / pieces, *motions))
    for near, far in pairwise(nodes):
        model.member(near, far, section, compression=compression)
    return model


def test_a_cantilever_under_loads_at_its_tip():
    """Check L^3 / 3EI, L / EI and L / EA; a force to the right turns the tip clockwise, by L^2 / 2EI."""
    EI, EA, length = 7.0, 90.0, 2.0
    model = upright(Section(EI, EA), length, 3)
    _, K = model.matrices()
    at = [model.coordinates[kind, 3] for kind in ("sway", "rise", "turn")]
    flexibility = np.linalg.inv(K)[np.ix_(at, at)]
    turn = -(length**2) / (2 * EI)
    expected = [[length**3 / (3 * EI), 0.0, turn], [0.0, length / EA, 0.0], [turn, 0.0, length / EI]]
    np.testing.assert_allclose(flexibility, expected, rtol=1e-11, atol=1e-12)


def test_vibration_of_a_cantilever():
    """Check omega = 1.875^2 sqrt(EI / m L^4); with cubics it is too high, by the fourth power of their length."""
    EI, line_mass, length = 7.0, 3.0, 2.0
    omega = 1.875104068711961**2 * np.sqrt(EI / (line_mass * length**4))
    errors = []
    for pieces in (2, 4):
        eigenvalues, _ = upright(Section(EI, 1e3, line_mass), length, pieces).modes()
        errors.append(np.sqrt(eigenvalues[0]) / omega - 1)
    assert 0 < errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


def test_buckling_of_a_cantilever():
    """Euler's load is pi^2 EI / 4 L^2; at this load the stiffness stops being positive definite."""
    EI, length = 7.0, 2.0
    euler = np.pi**2 * EI / (4 * length**2)
    least = [
        linalg.eigvalsh(upright(Section(EI, 1e3), length, 8, compression=part * euler).matrices()[1])[0]
        for part in (0.9999, 1.0001)
    ]
    assert least[0] > 0 > least[1]


def test_a_beam_between_posts_does_not_depend_on_where_it_points():
    """A member turned by any angle has the same eigenvalues of stiffness."""
    spectra = []
    for angle in (0.0, 0.4, 2.0):
        model = Model()
        motions = [[{(kind, end): 1.0} for kind in ("ux", "uy", "turn")] for end in (0, 1)]
        near, far = Node(0.0, 0.0, *motions[0]), Node(1.5 * np.cos(angle), 1.5 * np.sin(angle), *motions[1])
        model.member(near, far, Section(7.0, 90.0))
        spectra.append(linalg.eigvalsh(model.matrices()[1]))
    np.testing.assert_allclose(spectra[1:], [spectra[0]] * 2, rtol=0, atol=1e-11)
    assert np.all(np.abs(spectra[0][:3]) < 1e-12)


def test_a_portal_on_hinges():
    """With a rigid beam and hinged feet, a column is a cantilever from the beam: 3 EI / h^3 instead of 12."""
    clamped = Building(np.array([0.5]), np.array([1200.0]), np.array([3.0]))
    ratio = sway_modes(replace(clamped, column_base=0.0)).frequencies / sway_modes(clamped).frequencies
    assert ratio == pytest.approx(0.5, rel=1e-12)


def test_a_portal_with_a_bending_beam():
    """12 EI/h^3 (6s + 1) / (6s + 4), s = (EI_b / L) / (EI / h), two columns: Kleinlogel's portal, feet clamped."""
    height, span, column, beam = 0.5, 0.8, 11.0, 4.0
    stiffness = 2 * 12 * column / height**3
    frame = Building(
        np.array([height]), np.array([stiffness]), np.array([3.0]), column_x=(0.0, span), beam_bending=np.array([beam])
    )
    s = (beam / span) / (column / height)
    expected = np.sqrt(stiffness * (6 * s + 1) / (6 * s + 4) / 3.0) / (2 * np.pi)
    assert sway_modes(frame).frequencies[0] == pytest.approx(expected, rel=1e-12)


def test_sway_is_told_from_other_motion():
    """Masses on columns that stretch also move up and down; axially stiff columns put those modes far above."""
    heights, stiffness, mass = np.full(3, 0.4), np.full(3, 20e3), np.full(3, 10.0)
    stiff = Building(heights, stiffness, mass, column_axial=np.full(3, 1e7), vertical_inertia=True)
    eigenvalues, _ = assemble(stiff).modes()
    assert len(eigenvalues) == 9
    plain = sway_modes(Building(heights, stiffness, mass))
    found = sway_modes(stiff)
    np.testing.assert_allclose(found.frequencies, plain.frequencies, rtol=2e-3)
    np.testing.assert_allclose(found.shapes, plain.shapes, rtol=0, atol=2e-3)


def test_sway_mixed_with_other_motion_is_refused():
    """The columns are so soft axially that the frequencies of floor tilt and sway are close."""
    frame = Building(
        np.array([0.4]),
        np.array([1e5]),
        np.array([10.0]),
        column_x=(-0.4, 0.4),
        column_axial=np.array([1e4]),
        vertical_inertia=True,
    )
    with pytest.raises(ValueError, match="mixed"):
        sway_modes(frame)


def test_a_frame_that_buckles_is_refused():
    frame = Building(np.full(2, 0.4), np.full(2, 100.0), np.full(2, 10.0), gravity=9.81)
    with pytest.raises(ValueError, match="buckles"):
        sway_modes(frame)
