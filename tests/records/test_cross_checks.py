"""Compare with other maintained libraries on the same records, if they are installed."""

import numpy as np
import pytest

from cvxshear.data.kinds import mac
from cvxshear.io.modes import modes_from_file
from cvxshear.records import Channel, Run, TimeRecord, from_arrays, identify_modes
from cvxshear.records.simulate import PAPER_FRAME, ambient_record, base_record
from tests.records.shared import DATA, needs_southampton, southampton

# Warnings from inside these libraries do not concern this package.
pytestmark = pytest.mark.filterwarnings("ignore")


def by_poles(transition, output, rate):
    """Return frequencies, damping and shapes of a discrete state-space model, without strongly damped poles."""
    values, vectors = np.linalg.eig(transition)
    poles = np.log(values.astype(complex)) * rate
    used = (poles.imag > 0) & (-poles.real / np.abs(poles) < 0.05)
    order = np.argsort(np.abs(poles[used]))
    return np.abs(poles[used])[order] / (2 * np.pi), (output @ vectors)[:, used].T[order]


def test_pyoma2():
    single = pytest.importorskip("pyoma2.setup.single")
    ssi = pytest.importorskip("pyoma2.algorithms.ssi")
    record = ambient_record(PAPER_FRAME, 0, noise=0.05)
    setup = single.SingleSetup(record.runs[0].responses, fs=20.0)
    algorithm = ssi.SSI(name="ssi", method="cov", br=40, ordmax=12)
    setup.add_algorithms(algorithm)
    setup.run_by_name("ssi")
    setup.mpe("ssi", sel_freq=[1.03, 2.21, 3.28], order_in=10)
    theirs, ours = from_arrays(algorithm.result.Fn, algorithm.result.Phi.T), identify_modes(record)
    # Two estimators of one record differ by less than the uncertainty due to the record's length, 0.1 %.
    np.testing.assert_allclose(ours.frequencies, theirs.frequencies, rtol=2e-3)
    for first, second in zip(ours.mode_shapes, theirs.mode_shapes, strict=True):
        assert mac(first, second) > 0.9999


def test_mdof():
    mdof = pytest.importorskip("mdof")
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=200.0)
    shaken = record.runs[0]
    transition, _, output, *_ = mdof.sysid(shaken.excitation[None], shaken.responses.T, method="srim", order=6, dt=0.05)
    frequencies, shapes = by_poles(np.asarray(transition), np.asarray(output), 20.0)
    ours = identify_modes(record)
    assert len(ours.frequencies) == 3
    for frequency, shape in zip(ours.frequencies, ours.mode_shapes, strict=True):
        nearest = int(np.argmin(np.abs(frequencies - frequency)))
        assert frequencies[nearest] == pytest.approx(frequency, rel=2e-4)
        assert mac(shapes[nearest], shape) > 0.99999


def test_pyyeti():
    era = pytest.importorskip("pyyeti.era")
    omega = 2 * np.pi * np.array([2.0, 6.0])
    time = np.arange(2000) / 100
    modal = np.exp(-0.01 * omega * time[:, None]) * np.cos(omega * np.sqrt(1 - 1e-4) * time[:, None])
    values = modal @ np.array([[0.5, 1.0], [1.0, -0.6]]) + 1e-3 * np.random.default_rng(0).standard_normal((2000, 2))
    theirs = era.ERA(values.T[:, :, None], sr=100.0, svd_tol=4, auto=True, show_plot=False, verbose=False)
    record = TimeRecord(
        (Channel("a", 1), Channel("b", 2)), runs=(Run(values),), sampling_rate=100.0, input="free_decay"
    )
    ours = identify_modes(record)
    np.testing.assert_allclose(ours.frequencies, np.sort(theirs.freqs_hz), rtol=1e-3)
    np.testing.assert_allclose(ours.damping_ratios, 0.01, rtol=0.02)


@needs_southampton
def test_sdypy_ema(tmp_path):
    ema = pytest.importorskip("sdypy.EMA")
    table = np.loadtxt(DATA / "southampton" / "set-3.csv", delimiter=",", skiprows=1)
    functions = (table[:, 1::2] + 1j * table[:, 2::2]).T
    model = ema.Model(functions, table[:, 0], lower=5, upper=60, pol_order_high=60, frf_type="accelerance")
    model.get_poles(show_progress=False)
    # Which order the library chooses depends on the last digits of the linear algebra, and some orders split a mode
    # into two poles. The median over the orders does not depend on them.
    model.pole_ind = np.array([median_pole(model, frequency) for frequency in (6.51, 17.46, 26.50)])
    model.nat_freq = np.array([model.pole_freq[order][place] for order, place in model.pole_ind])
    model.nat_xi = np.array([model.pole_xi[order][place] for order, place in model.pole_ind])
    model.get_constants()
    theirs = from_arrays(model.nat_freq, model.A.T, damping_ratios=model.nat_xi)
    ours, _ = modes_from_file(southampton(tmp_path))
    np.testing.assert_allclose(theirs.frequencies, ours.frequencies, rtol=5e-4)
    np.testing.assert_allclose(theirs.damping_ratios, ours.damping_ratios, rtol=0.05)
    assert min(mac(a, b) for a, b in zip(theirs.mode_shapes, ours.mode_shapes, strict=True)) > 0.99


def median_pole(model, frequency):
    """Return the order and the place of the pole that is nearest to the median of all orders' poles of a mode."""
    indices = [
        (order, place)
        for order, (frequencies, dampings) in enumerate(zip(model.pole_freq, model.pole_xi, strict=True))
        for place in np.flatnonzero((abs(frequencies - frequency) < 0.5) & (dampings > 0) & (dampings < 0.05))
    ]
    poles = np.array([model.all_poles[order][place] for order, place in indices])
    median = np.median(poles.real) + 1j * np.median(abs(poles.imag))
    return indices[int(np.argmin(abs(poles - median)))]
