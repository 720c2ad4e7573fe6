"""Print all figures of trust as one table: `python -m tests.studies figures [--quick] [--json OUT] [--before OUT]`.

Each figure comes from a study of this folder. `--json` writes the figures to a file, and `--before` shows those of such
a file beside the new ones. `--quick` takes a small sample, which needs about eight minutes on one core. Times are
processor times, as ratios to 60 symmetric eigenproblems of size 200 in the same run.
"""

import argparse
import itertools
import json
import os
import time
from functools import partial
from pathlib import Path

import numpy as np

import cvxshear
from cvxshear.io.toml import BUILT_IN
from cvxshear.records import identify_modes
from cvxshear.util.parallel import each
from tests.studies import calibration, loops, outside, reconstruction, record_faults, scaling
from tests.studies.backends import COLUMNS, answers, bounded, programs_of_examples
from tests.studies.timing import fastest, table
from tests.test_house import sizes

SLOW = ("los-alamos", "iasc-asce-x", "iasc-asce-y", "ucl-loosened-joints")  # frames of many states


def calibrated(quick, jobs):
    """Count right sets of causes, causes added to sound frames, and covered masses and stiffnesses."""
    trials, pairs, nothing = (1, 1, 1) if quick else (5, 2, 40)
    placed = calibration.run([*calibration.trials(trials, seed=1), *calibration.pairs(pairs, seed=1)], jobs)
    empty = calibration.run(calibration.nothing(nothing, seed=1), jobs)
    for title, (count, of) in calibration.shares(placed).items():
        yield f"calibration: {title}", f"{count} of {of}"
    yield "calibration: sound frames with a cause added", f"{sum(bool(r.found) for r in empty)} of {len(empty)}"
    several = [r for r in (*placed, *empty) if r.trial.configurations > 1]
    yield "calibration: values within 1.96 deviations", "{} of {}".format(*calibration.coverage(several))


def foreign(quick, jobs):
    """Count false causes, and causes whose kind is identified, outside the catalogue."""
    found = outside.outcomes(1 if quick else 6, 1, jobs=jobs)
    yield "outside: something false with 95 %", f"{sum(r.false > 0 for r in found)} of {len(found)}"
    yield "outside: kind of cause named", f"{sum(r.told for r in found)} of {sum(r.visible for r in found)} visible"
    yield "outside: values within 1.96 deviations", "{} of {}".format(*np.sum([r.covered for r in found], axis=0))


def practice(quick, jobs):
    """Count the practice cases, beside the measured data, whose cause is found at its place."""
    folder = Path(os.environ.get("CVXSHEAR_SHARED", "")) / "cases"
    truth = json.loads((folder / "truth.json").read_text()) if folder.exists() else {}
    results = each(partial(case_is_right, folder), truth.items(), jobs=jobs)
    yield "cases: cause and place right", f"{sum(results)} of {len(results)}"


def case_is_right(folder, case):
    """Return whether the loop names the true causes, at their place or with the true place among the rivals."""
    name, true = case
    effects = cvxshear.close_loop(folder / f"{name}.toml").to_dict()["effects"]
    wanted = true.get("effects", [true.get("effect")])
    if len(effects) != 1 or len(wanted) != 1:
        return sorted(item["name"] for item in effects) == sorted(filter(None, wanted))
    place = {"name": wanted[0]} | ({"floor": true["floor"]} if "floor" in true else {})
    place |= {"configuration": f"test {true['configuration']}"} if "configuration" in true else {}
    return any(place.items() <= item.items() for item in [effects[0], *effects[0]["rivals"]])


def measured(quick, jobs):
    yield from each(frequency_errors, [name for name in BUILT_IN if not (quick and name in SLOW)], jobs=jobs)


def frequency_errors(name):
    """Return the largest frequency error of a measured frame before and after the loop."""
    found = cvxshear.close_loop(name)
    before, after = (fit.quality.max_frequency_error for fit in (found.before, found.after))
    return f"measured: {name}", f"{before:.3%} to {after:.3%}, {found.verdict}"


def faulty_records(quick, jobs):
    """Count how faults of records are handled, and how often a sound channel is accused."""
    faults, inputs = ["sound", *record_faults.NAMED_BY], record_faults.INPUTS
    cases = [(n, inputs[i % 4], fault) for n in range(1 if quick else 12) for i, fault in enumerate(faults, n)]
    found = each(judged_fault, cases, jobs=jobs)
    yield "record faults: named or refused", f"{found.count('named') + found.count('refused')} of {len(cases)}"
    yield "record faults: another channel accused", f"{found.count('accused')} of {len(cases)}"


def judged_fault(case):
    return record_faults.judged(record_faults.case_of(*case))[0]


def reconstructed(quick, jobs):
    """Return the rms error of peak drifts without sensors."""
    for stories, case in itertools.product((3,) if quick else (3, 8), reconstruction.CASES):
        run = partial(reconstruction.trial, stories=stories, case=case)
        off = np.sqrt(np.mean([trial[0][2] ** 2 for trial in each(run, range(1 if quick else 6), jobs=jobs)]))
        yield f"reconstruction: peak drift error, {stories} stories, {case}", f"{100 * off:.1f} %"


def solved(quick, jobs):
    """Count how each backend's answers are accepted."""
    programs = programs_of_examples(["paper"] if quick else BUILT_IN) + [bounded(seed) for seed in range(10)]
    for name in cvxshear.backends.available():
        counts = answers(name, programs)
        yield f"backend {name}", ", ".join(f"{key} {counts[key]}" for key in COLUMNS if counts[key])


def timed(quick, jobs):
    """Return processor times relative to 60 symmetric eigenproblems of size 200."""
    matrices = np.random.default_rng(0).standard_normal((60, 200, 200))
    unit, _ = fastest(lambda: np.linalg.eigh(matrices + matrices.swapaxes(1, 2)), 3, time.process_time)
    tall, models, motion = scaling.exact_experiment(100)[0], *reconstruction.setting(3, "soft", 0)[:2]
    runs = {
        "one-shot, 100 stories": lambda: cvxshear.identify(tall, "one-shot"),
        "efficient, 8 stories": lambda: cvxshear.identify(loops.measured(8), "efficient"),
        "loop, the paper's frame": lambda: cvxshear.close_loop("paper"),
        "modes of a record": lambda: identify_modes(record_faults.sound_record(0, "force")),
        "reconstruction, 3 stories": lambda: reconstruction.reconstruct(models, motion, leave_out=False),
    }
    for name, run in runs.items():
        yield f"time: {name}", f"{fastest(run, 1 if quick else 3, time.process_time)[0] / unit:.2f}"


PARTS = {
    "calibration": calibrated, "outside": foreign, "cases": practice, "measured": measured, "records": faulty_records,
    "reconstruction": reconstructed, "backends": solved, "times": timed,
    "sizes": lambda quick, jobs: ((f"size: {name}", f"{size:,}") for name, size in sizes().items()),
}  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="by default all")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path, metavar="OUT")
    parser.add_argument("--before", type=Path, metavar="OUT")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    given = parser.parse_args()
    found = {name: value for part in given.parts or PARTS for name, value in PARTS[part](given.quick, given.jobs)}
    columns = ({"before": json.loads(given.before.read_text())} if given.before else {}) | {"now": found}
    rows = [[name, *(values.get(name, "") for values in columns.values())] for name in found]
    table("Figures of trust", ["figure", *columns], rows)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
