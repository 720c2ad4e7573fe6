"""Test the predicted noise of a record: Au's factors against the spectrum, and against simulated records."""

import numpy as np
import pytest
from scipy.integrate import quad

from cvxshear.model import mass_matrix, modes, stiffness_matrix
from cvxshear.planning.tested_model import BAND_WIDTH, SAMPLES_A_PERIOD, Recorded, band_factors
from cvxshear.records.simulate import PAPER_FRAME
from cvxshear.util.errors import InputError

WHICH = np.arange(3)


def of_record(noise, found, masses):
    """Return the standard deviations that come of a record, without those of sensors' gains (0.5 % of an entry)."""
    frequency, entries = noise.of(found, masses, WHICH)
    return frequency, np.sqrt(entries**2 - 0.005**2)


def paper_modes():
    return modes(mass_matrix(PAPER_FRAME.masses), stiffness_matrix(PAPER_FRAME.stiffnesses))


def test_the_band_factors_are_fisher_information_of_a_resonance():
    """Differentiate log(S / (1 + u^2)), u in half-widths of the resonance: the information of a Whittle likelihood."""
    for kappa in (1.0, 4.0, 10.0):
        frequency = quad(lambda u: (2 * u / (1 + u**2)) ** 2, -kappa, kappa)[0]
        slope = quad(lambda u: 2 / (1 + u**2), -kappa, kappa)[0]
        np.testing.assert_allclose(band_factors(kappa), (frequency / (2 * np.pi), slope / 4), rtol=1e-8)


def test_ambient_frequencies_follow_aus_law():
    found = paper_modes()
    std, _ = Recorded("ambient", 1200.0, damping=0.01).of(found, PAPER_FRAME.masses, WHICH)
    wide = np.sqrt(0.01 / (2 * np.pi * 1200.0 * found.frequencies))
    np.testing.assert_allclose(std, wide / np.sqrt(band_factors(BAND_WIDTH)[0]))


def test_four_times_the_record_halves_every_standard_deviation():
    short, long = (of_record(Recorded("ambient", T), paper_modes(), PAPER_FRAME.masses) for T in (600.0, 2400.0))
    for once, again in zip(short, long, strict=True):
        np.testing.assert_allclose(once, 2 * again)


@pytest.mark.parametrize(
    ("kind", "duration", "frequency", "entries"),
    [
        ("ambient", 1200.0, (0.146, 0.106, 0.080), (0.075, 0.265, 0.347)),
        ("shaker", 1200.0, (0.0054, 0.0045, 0.0036), (0.021, 0.060, 0.132)),
        ("hammer", 900.0, (0.0022, 0.0015, 0.0008), (0.047, 0.045, 0.057)),
    ],
)
def test_the_laws_are_what_simulated_records_scatter_by(kind, duration, frequency, entries):
    """The expected root mean square errors (%) of twenty seeds with 5 % noise come from `tests.studies.records`."""
    noise = Recorded(kind, duration, damping=0.01, sensor_noise=0.05)
    expected = of_record(noise, paper_modes(), PAPER_FRAME.masses)
    for law, seen in zip(expected, (frequency, entries), strict=True):
        ratio = np.array(seen) / (100 * law)
        assert np.all((ratio > 0.55) & (ratio < 1.5)), ratio


@pytest.mark.parametrize("kind", ["shaker", "hammer", "ambient"])
def test_entries_scatter_by_the_spectra_about_their_resonance(kind):
    """Sensor noise, and other modes in ambient records, add to the spectrum of a resonance.

    Compute the integrals of the resonance and the derivatives of the entries over the largest entry numerically.
    """
    zeta, duration, noise = 0.02, 700.0, 0.04
    found = paper_modes()
    phi, f, m = found.shapes, found.frequencies, PAPER_FRAME.masses
    _, stds = of_record(Recorded(kind, duration, damping=zeta, sensor_noise=noise), found, m)
    joint = np.outer(phi @ m, phi @ m) if kind == "shaker" else phi @ phi.T
    # The factor is (1 / 2)^2 / (x^2 + zeta^2), with x the distance from the resonance over its frequency.
    power = quad(lambda x: 0.25 / (x**2 + zeta**2), -np.inf, np.inf)[0]
    channels = sum(phi[j] ** 2 * joint[j, j] * power * f[j] for j in range(3))
    inside = quad(lambda u: 0.5 / (1 + u**2), -BAND_WIDTH, BAND_WIDTH)[0]
    for mode, std in enumerate(stds):
        spread = np.diag(noise**2 * channels / (SAMPLES_A_PERIOD * f[2] / 2))
        for other in {0, 1, 2} - {mode} if kind == "ambient" else ():
            r = f[mode] / f[other]
            gain = abs(r**2 / (1 - r**2 + 2j * zeta * r)) ** 2
            left = joint[other, other] * (1 - joint[mode, other] ** 2 / (joint[mode, mode] * joint[other, other]))
            spread += gain * left * np.outer(phi[other], phi[other])
        spread *= zeta / (joint[mode, mode] * duration * f[mode] * inside)
        top = np.argmax(np.abs(phi[mode]))
        step = 1e-6 * np.eye(3)
        slopes = [(phi[mode] + each) / (phi[mode] + each)[top] - phi[mode] / phi[mode][top] for each in step]
        turn = np.array(slopes).T / 1e-6
        assert std == pytest.approx(np.sqrt(np.mean(np.diag(turn @ spread @ turn.T))), rel=1e-4)


def test_a_record_that_is_too_short_is_refused():
    with pytest.raises(InputError, match="periods of the lowest mode in the record"):
        Recorded("ambient", 5.0).of(paper_modes(), PAPER_FRAME.masses, WHICH)
    with pytest.raises(InputError, match="excitation must be one of ambient, shaker, hammer"):
        Recorded("wind", 5.0)
