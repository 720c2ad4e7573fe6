"""Test the descriptions of `check`, `plan` and `predict`: equal content in terminal, prompt and notebook."""

import dataclasses
import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from rich.cells import cell_len
from scipy import signal

import cvxshear
from cvxshear.planning import plan
from cvxshear.priors import Bounds
from cvxshear.records.record import Finding
from cvxshear.report.blocks import Sentence, Table, describe
from cvxshear.report.terminal import notebook_html
from cvxshear.response import DrivenRecord, DrivenRun, predict
from cvxshear.screening import Screening
from tests.fe.experiments import simulated
from tests.planning.common import NOISE, slow_covariance, tapered
from tests.report.conftest import NASTY, parts, table
from tests.response.common import damped_frame, declared, integrated, matrices, pole_ratios, shaking

SWAPPED = Path(__file__).resolve().parents[2] / "examples" / "swapped_sensors.toml"
STEP = 0.01


def column(of, at):
    """Return the numbers of a table's column, starting at the lowest floor."""
    return [float(re.match(r"[-+\d.e]+", row[at])[0]) for row in reversed(of.rows) if row[at]]


@pytest.fixture(scope="module")
def planned():
    return plan(tapered(4, mass_std=0.02, stiffness_std=0.1), 2, modes=3, noise=NOISE)


@pytest.fixture(scope="module")
def shaken():
    """Return a damped frame, its base motion, and its response by another integrator."""
    M, C, K = matrices(*(frame := damped_frame(3)))
    base = shaking()
    return frame[:2], (M, C, K), base, integrated(M, C, K, base, STEP)


@pytest.fixture(scope="module")
def predicted(shaken):
    frame, pencil, base, (total, _) = shaken
    experiment = cvxshear.Experiment.from_dict(declared(*frame, pole_ratios(*pencil)), name="three stories")
    runs = (DrivenRun(base, responses=total),)
    motion = DrivenRecord(runs, 1 / STEP, floors=[1, 2, 3], added_mass=np.zeros(3), name="shaken")
    return predict(experiment, motion, damping="story", detrend=False)


@pytest.fixture(scope="module")
def screened():
    return Screening.of(cvxshear.load(SWAPPED), [Finding("drift", "channel 3 drifts by 2 %")])


@pytest.mark.parametrize("result", ["planned", "predicted", "screened"])
def test_prompt_print_and_notebook_show_the_same(result, request):
    found = request.getfixturevalue(result)
    assert len(repr(found)) < 250
    assert "\n" not in repr(found)
    said, page = str(found), notebook_html(found)
    assert max(cell_len(line) for line in said.splitlines()) <= 80
    for shown in parts(found, Table):
        assert f'id="{shown.key}"' in page
        for row in shown.rows:
            for cell in row:
                assert cell in said
                assert f">{html.escape(cell)}<" in page
    plain, headline = re.sub(r"\s+", " ", said), describe(found).headline
    assert re.sub(r"\s+", " ", headline) in plain
    for sentence in parts(found, Sentence):
        assert sentence.text in plain


def test_a_plan_is_described_by_its_expected_deviations(planned):
    """Deviations are root mean squares over frames drawn from the priors: here over other draws."""
    design, floors, variances = planned.model.design, np.array(planned.sensors) - 1, []
    std = np.repeat([0.02, 0.1], 4)
    for drawn in np.random.default_rng(3).standard_normal((30, 8)):
        for sign in (1, -1):
            mass, stiffness = np.split(design.sizes * np.exp(sign * std * drawn), 2)
            frame = dataclasses.replace(design, floor_mass=mass, story_stiffness=stiffness)
            found = slow_covariance(frame, [np.zeros(4)], floors, 3, NOISE, mass_std=0.02, stiffness_std=0.1)
            variances.append(np.diag(found))
    expected = 100 * np.sqrt(np.mean(variances, axis=0))
    shown = table(planned, "accuracy-table")
    assert column(shown, 2) == pytest.approx(expected[:4], rel=0.02)
    assert column(shown, 4) == pytest.approx(expected[4:], rel=0.02)
    assert describe(planned).headline.startswith(f"Measure floors {planned.sensors[0]}, {planned.sensors[1]} in 1 test")


def test_a_plan_is_told_in_units_that_fit_and_what_is_laid_on_floors_in_kg(planned):
    mass, stiffness = planned.model.design.floor_mass, planned.model.design.story_stiffness
    shown = table(planned, "accuracy-table")
    assert shown.head[1] == "mass, t"
    assert column(shown, 1) == pytest.approx(mass / 1e3, rel=1e-3)
    assert table(planned, "added-mass").title == "tests: added mass, kg"
    assert shown.head[3] == "stiffness, MN/m"
    assert column(shown, 3) == pytest.approx(stiffness / 1e6, rel=1e-3)


def test_what_a_plan_leaves_open_is_called_so():
    """A frame whose masses and stiffnesses are known to five times their size: one mode on one floor tells nothing."""
    cannot = plan(tapered(4, mass_std=5.0, stiffness_std=5.0), 1, modes=1, criterion="E")
    can = plan("paper", fresh=True, criterion="E")
    assert cannot.objective > 1.0
    assert can.objective < 1.0
    said = [sentence.text for sentence in parts(cannot, Sentence)]
    assert any(
        "Standard deviation of the worst combination (criterion E): open, 100 % or more" in each for each in said
    )
    assert {cell for row in table(cannot, "counts").rows for cell in row[2:]} == {"open"}
    said = [sentence.text for sentence in parts(can, Sentence)]
    assert any(f"(criterion E): {100 * can.objective:.2f} %" in each for each in said)
    assert "open" not in {cell for row in table(can, "counts").rows[1:] for cell in row[2:]}


def between_samples(pencil, base, finer=32):
    """Return accelerations and displacements at `finer` times the samples, for a linear excitation, by `lsim`."""
    M, C, K = pencil
    n, rest = len(M), -np.linalg.solve(M, np.hstack([K, C]))
    A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), rest])
    B = np.repeat([0.0, -1.0], n)[:, None]
    system = (A, B, np.vstack([rest, np.eye(n, 2 * n)]), np.zeros_like(B))
    steps = np.arange(0, len(base) - 1, 1 / finer)
    _, found, _ = signal.lsim(system, np.interp(steps, np.arange(len(base)), base), steps * STEP)
    return found[:, :n], found[:, n:]


def test_a_prediction_is_described_by_its_peaks_and_errors(predicted, shaken):
    total, relative = between_samples(*shaken[1:3])
    shown = table(predicted, "prediction-peaks")
    assert shown.head[1:4] == ("acceleration, m/s²", "displacement, mm", "drift, mm")
    drift = np.diff(np.column_stack([np.zeros(len(relative)), relative]), axis=1)
    # The base's row, with its moment, has no cell in these columns.
    for at, values in ((1, total), (2, 1e3 * relative), (3, 1e3 * drift)):
        assert column(shown, at) == pytest.approx(np.max(np.abs(values), axis=0), rel=5e-3)
    errors = table(predicted, "prediction-errors")
    # The loop added no effect, so the models before and after are equal.
    assert [row[0] for row in errors.rows] == ["3", "2", "1"]
    # The model has the exact modes of the frame. Both methods integrate the same motion.
    assert errors.head[1:4] == ("error in time", "rms", "peak")
    for row in errors.rows:
        assert all(abs(float(cell.strip("<%+ "))) <= 0.5 for cell in row[1:4])
    rows = table(predicted, "story-dashpots").rows
    for row, exact in zip(reversed(rows), damped_frame(3)[2], strict=True):
        found, std = map(float, row[1].split(" ± "))
        assert abs(found - exact) < 2 * std < 0.5 * exact
    most = np.argmax(np.max(np.abs(drift), axis=0))
    assert describe(predicted).headline.startswith(f"Story {most + 1} drifts most: ")
    assert "the measured accelerations of floors 1, 2, 3 are missed by " in describe(predicted).headline
    said = parts(predicted, Sentence)[0].text
    assert said.startswith("three stories (configuration 1) under base motion of shaken: 4.0 s at 100 Hz, by the ")


def test_the_damping_of_a_frame_describes_itself(predicted):
    ratios = 100 * pole_ratios(*matrices(*damped_frame(3)))
    shown = table(predicted.damping, "damping-ratios")
    assert [float(row[1].split(" ±")[0]) for row in shown.rows] == pytest.approx(ratios, rel=2e-3)
    assert shown == table(predicted, "damping-ratios")
    assert repr(predicted.damping) == "<IdentifiedDamping story damping of 3 modes>"


def test_a_screening_says_what_to_change(screened):
    said = re.sub(r"\s+", " ", str(screened))
    assert said.startswith('swapped_sensors: 1 mistake and 1 remark MISTAKE: swapped_sensors in configuration "bare"')
    (finding,) = screened.findings
    for text in (finding.found, finding.change, finding.how_to_accept, "RECORD: drift found channel 3 drifts by 2 %"):
        assert text in said
    assert screened.refused
    assert json.loads(json.dumps(screened.to_dict()))["record"][0]["kind"] == "drift"


def test_a_screening_that_found_nothing_says_so_with_what_was_accepted():
    experiment = cvxshear.load(SWAPPED).to_dict()
    experiment["frame"]["accept"] = ["swapped_sensors"]
    found = Screening.of(cvxshear.Experiment.from_dict(experiment, name=NASTY))
    assert not found.refused
    assert "nothing looks wrong" in " ".join(str(found).split())
    assert "accepted beforehand: swapped_sensors" in str(found)
    assert "<img" not in notebook_html(found)


@pytest.mark.parametrize(("times", "said"), [(1.0, False), (30.0, True)])
def test_deviations_that_are_far_too_large_are_said(times, said):
    """The modes have noise of the stated size, and stated deviations thirty times larger."""
    declared, _ = simulated(None, stories=4, configurations=2, rng=np.random.default_rng(5))
    for each in declared["configuration"]:
        for key in ("frequency_std", "mode_shape_std"):
            each[key] = (times * np.asarray(each[key])).tolist()
    found = cvxshear.identify(cvxshear.Experiment.from_dict(declared))
    warned = [each.text for each in parts(found, Sentence) if "times smaller than the stated" in each.text]
    assert len(warned) == said
    for text in warned:
        assert float(text.split(" is ")[1].split(" times")[0]) == pytest.approx(times, rel=0.5)


PRICE = re.compile(r"one more N/m on the upper bound of story stiffness 1 would lower the misfit by ([\d.e-]+)")
HOW = ("as_given", "polished", "replaced")


@pytest.fixture(scope="module")
def example():
    """Return the paper's example with declared noise."""
    declared = cvxshear.load("paper").to_dict()
    for each in declared["configuration"]:
        each |= {"frequency_std": 0.002, "mode_shape_std": 0.01}
    return cvxshear.Experiment.from_dict(declared)


def limited(example, upper):
    prior = Bounds("story_stiffness", upper=[upper, 1e9])
    return cvxshear.identify(dataclasses.replace(example, priors=(prior,)))


def test_a_printed_price_is_what_a_wider_bound_gains(example):
    held, wider = limited(example, 23500.0), limited(example, 23501.0)
    (price,) = PRICE.findall(" ".join(str(held).split()))
    assert float(price) == pytest.approx(held.parts[0].fit.chi2 - wider.parts[0].fit.chi2, rel=0.02)
    assert PRICE.search(" ".join(notebook_html(held).split()))
    (as_json,) = held.to_dict()["active"]
    assert float(price) == pytest.approx(as_json["dual"], rel=0.01)


def test_nothing_is_printed_where_no_bound_is_active(example):
    for result in (cvxshear.identify(example), limited(example, 1e9)):
        assert "price" not in str(result)


def test_accepted_polished_and_replaced_answers_are_printed(comparison):
    (table,) = next(each for each in describe(comparison).sections if each.key == "worst").parts
    assert table.head[2:5] == ("as given", "polished", "replaced")
    for name, solved, *accepted in (row[:5] for row in table.rows):
        rows = [each for each in comparison.rows if each.backend == name]
        assert list(map(int, accepted)) == [sum(getattr(x, how) for x in rows) for how in HOW]
        assert sum(map(int, accepted)) >= int(solved.split()[0])
    assert all(word in str(comparison) for word in table.head[3:5])
