"""Trends of one frame over many tests: steps, slopes, and the influence of temperature and amplitude.

The tests are one experiment with one frame. A trend is an effect like all others: the stiffness of one story, or of all
stories, times exp(p x), with a known number x of each test,

    step:         0 before a test, 1 from this test on
    slope:        from -1/2 at the first test to 1/2 at the last, by date (without dates by the order of the tests)
    temperature:  T less its mean, in parts of `SEASONS`
    amplitude:    log10 of A less its mean

The loop weighs the trends: its search, evidence, noise and rivals decide.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear import backends, effects
from cvxshear.fit.efficient import efficient
from cvxshear.io.formats import named_after
from cvxshear.io.toml import load
from cvxshear.loop.close import search_for_effects
from cvxshear.loop.results import AddedEffect, LoopResult
from cvxshear.measurement.configuration import DEFAULT_MODE_SHAPE_STD, Configuration
from cvxshear.measurement.experiment import Experiment
from cvxshear.screening.screen import refuse_mistakes
from cvxshear.util import checks, decorators, errors, quantities, results
from cvxshear.util.typing import Floats, Json

#: Smallest number of tests: between two tests, a step and a slope are the same.
FEWEST_TESTS = 3

#: Range of outdoor temperatures over the years, degrees C: the unit of the influence of temperature.
SEASONS = 50.0

#: Kinds of trends, with the words behind their sizes.
HOW = {
    "step": "from {since} on",
    "slope": "evenly from the first test to the last",
    "temperature": "per °C",
    "amplitude": "per tenfold amplitude",
}


@dataclass(frozen=True)
class TrendPlace(effects.Place):
    """Place of a trend: one story, or all stories without a story.

    Parameters
    ----------
    kind : str
        One of `HOW`.
    first : str or None
        First test after a step.
    since : str or None
        This test with its date, in words.
    """

    kind: str = "slope"
    first: str | None = None
    since: str | None = None

    def label(self, subject: str) -> str:
        """Name the trend, such as 'step of story 2 from "12" (2024-05-03) on'."""
        return f"{self.kind} of {self.who}{f' from {self.since} on' if self.since else ''}"

    @property
    def who(self) -> str:
        """The story or stories in words."""
        return "every story" if self.story is None else f"story {self.story}"

    def sized(self, p: float, std: float) -> tuple[float, float]:
        """Return the relative change of stiffness (in all, per degree C, or per factor of ten) and its std."""
        if self.kind == "temperature":
            return p / SEASONS, std / SEASONS
        return float(np.expm1(p)), float(np.exp(p)) * std

    def words(self, p: float, std: float) -> str:
        """Write the trend with its size: 'story 2 lost 3.0 ± 0.2 % of its stiffness from "2024-05-03" on'."""
        size, deviation = self.sized(p, std)
        lost, gained = ("lost", "gained") if self.kind in ("step", "slope") else ("loses", "gains")
        how_much = quantities.with_std(100 * abs(size), 100 * deviation, "%")
        how = HOW[self.kind].format(since=self.since)
        return f"{self.who} {gained if size > 0 else lost} {how_much} of its stiffness {how}"


#: The number x of each test by its name, for each trend.
Courses = Mapping[TrendPlace, Mapping[str, float]]


class Trend(effects.Effect):
    """k_i exp(p x).

    Steps and slopes have the expected size of `StoryChange`. Temperature (over `SEASONS`) and amplitude (over a factor
    of ten) have the size of `StateStiffness`. Materials soften with both, so one of the two is as probable as not. A
    slope is as probable as a step at any test.
    """

    name = "trend"
    summary = "A stiffness that steps, drifts, or follows temperature or amplitude over many tests."
    formula = "k_i exp(p x), x a known number of each test"
    source = "first order of a smooth dependence of the logarithm of the stiffness"
    stage = "story"
    parameters = (effects.Parameter("p", ""),)

    def __init__(self, name: str, usual: float, probability: float, courses: Courses) -> None:
        vars(self).update(name=name, usual=usual, probability=probability)
        self.courses = courses

    def places(self, experiment: Experiment) -> list[effects.Place]:
        return list(self.courses)

    def weight(self, place: effects.Place, experiment: Experiment) -> float:
        return len(experiment.configurations) - 1.0 if _trend(place).kind == "slope" else 1.0

    def apply(self, state: effects.State, place: effects.Place, values: Floats, own: slice) -> effects.State:
        x = self.courses[_trend(place)][state.tested.name]
        at = slice(None) if place.story is None else slice(place.story - 1, place.story)
        k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
        factor = np.exp(values[0] * x)
        k[at] *= factor
        dk[:, at] *= factor
        dk[own, at] += x * k[at]
        return state.having(story_stiffness=k, d_story_stiffness=dk)

    def phrase(
        self, place: effects.Place, values: Floats, std: Floats, scale: effects.Scale, units: Sequence[str]
    ) -> str:
        return _trend(place).words(float(values[0]), float(std[0]))


def _trend(place: effects.Place) -> TrendPlace:
    assert isinstance(place, TrendPlace)
    return place


@dataclass(frozen=True)
class StiffnessChange(results.InJson):
    """A trend that is more than scatter, or may be.

    Parameters
    ----------
    kind : str
        "step", "slope", "temperature" or "amplitude".
    story : int or None
        None for all stories.
    test : str or None
        First test after a step.
    probability : float
        Probability of the trend; of a step, at any test.
    size, std : float
        Relative change of stiffness: in all, per degree C, or per factor of ten in amplitude.
    text : str
    other_tests : tuple of str
        Other possible beginnings of a step, the most probable first.
    rivals : tuple of str
        Other trends that may be there in its place.
    """

    kind: str
    story: int | None
    test: str | None
    probability: float
    size: float
    std: float
    text: str
    other_tests: tuple[str, ...]
    rivals: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class History(results.Shown):
    """Result of `history`.

    Parameters
    ----------
    loop : LoopResult
        The loop over all tests; its experiment has the tests in order, and its effects are the trends.
    changes : tuple of StiffnessChange
        The trends that the loop added, the most probable first.
    story_stiffness, story_stiffness_std : ndarray, shape (tests, N)
        N/m, of each test alone with the masses of the loop.
    fitted : ndarray, shape (tests, N)
        N/m, of the loop's final model.
    skipped : tuple of str
        Files that could not be used, each with the reason.
    """

    loop: LoopResult
    changes: tuple[StiffnessChange, ...]
    story_stiffness: Floats
    story_stiffness_std: Floats
    fitted: Floats
    skipped: tuple[str, ...]

    json_keys = "verdict=loop.verdict changes tests skipped noise=loop.noise averaged=loop.averaged models=loop.models"

    @property
    def tests(self) -> list[Json]:
        """Name, date, temperature, amplitude, modes, frequencies, damping ratios and stiffnesses of each test."""
        keys = ("name", "date", "temperature", "amplitude", "modes", "frequencies", "damping_ratios")
        alone = zip(self.story_stiffness, self.story_stiffness_std, self.fitted, strict=True)
        return [
            {key: getattr(each, key) for key in keys}
            | {"story_stiffness": k, "story_stiffness_std": std, "fitted_stiffness": fitted}
            for each, (k, std, fitted) in zip(self.loop.experiment.configurations, alone, strict=True)
        ]

    def by_mode(self, key: str) -> dict[int, Floats]:
        """Return the "frequencies" or "damping_ratios" of each mode over the tests, nan where not measured."""
        tests = self.loop.experiment.configurations
        found = {mode: np.full(len(tests), np.nan) for mode in sorted({int(i) for each in tests for i in each.modes})}
        for at, each in enumerate(tests):
            if (values := getattr(each, key)) is not None:
                for mode, value in zip(each.modes.tolist(), values.tolist(), strict=True):
                    found[mode][at] = value
        return {mode: values for mode, values in found.items() if np.isfinite(values).any()}


@decorators.usual_arithmetic
def history(folder: str | Path | Sequence[str | Path], backend: str | backends.Backend = "auto") -> History:
    """Find how the stiffness of a frame changed over many tests: steps, slopes, temperature and amplitude.

    Parameters
    ----------
    folder : str or Path, or sequence of them
        A folder of measurement files (TOML), or the files. They declare the same frame and the same priors; each
        configuration is a test with its `date`, `temperature` and `amplitude`. Without dates the order of the files'
        names counts.
    backend : str or Backend, optional

    Returns
    -------
    History

    Raises
    ------
    InputError
        If the folder has fewer than three usable tests, if the files declare different frames, or if some tests have
        a date, temperature or amplitude and others have none.
    NoSolutionError
        If the frame could not be fitted.
    """
    experiment, skipped = one_experiment(folder)
    solver = backends.get(backend)
    over_time, follows = courses(experiment)
    looked_for = [Trend("change", effects.StoryChange.usual, 0.1, over_time)]
    if follows:
        looked_for.append(Trend("dependence", effects.StateStiffness.usual, 0.5, follows))
    found = search_for_effects(experiment, looked_for, backend=solver)
    tests = found.experiment.configurations
    alone = [_alone(found, each, solver) for each in tests]
    models = {model.state.tested.name: model for model in found.estimate.fit.at.models}
    fitted = np.array([models[each.name].state.story_stiffness for each in tests])
    changes = tuple(_change(item) for item in found.effects)
    stiffness, std = (np.array(each) for each in zip(*alone, strict=True))
    return History(found, changes, stiffness, std, fitted, skipped)


def courses(experiment: Experiment) -> tuple[Courses, Courses]:
    """Return x of every test for each step and slope, and for temperature and amplitude where they are declared."""
    tests, stories = experiment.configurations, (None, *range(1, experiment.stories + 1))
    order = np.arange(len(tests))
    time = order if (dates := _dates(tests)) is None else np.array(dates)
    over_time = {TrendPlace(story=i): _centred(time / max(float(np.ptp(time)), 1e-9)) for i in stories}
    for at, test in enumerate(tests[1:], 1):
        dated = f" ({test.date})" if test.date is not None and test.date not in test.name else ""
        step = TrendPlace(kind="step", first=test.name, since=f'"{test.name}"{dated}')
        over_time |= {replace(step, story=i): (order >= at).astype(float) for i in stories}
    follows = {}
    if temperatures := _of_all(tests, "temperature"):
        follows[TrendPlace(kind="temperature")] = _centred(np.array(temperatures) / SEASONS)
    if amplitudes := _of_all(tests, "amplitude"):
        follows[TrendPlace(kind="amplitude")] = _centred(np.log10(amplitudes))
    names = [each.name for each in tests]
    found = [
        {place: dict(zip(names, course.tolist(), strict=True)) for place, course in each.items() if np.any(course)}
        for each in (over_time, follows)
    ]
    return found[0], found[1]


def one_experiment(folder: str | Path | Sequence[str | Path]) -> tuple[Experiment, tuple[str, ...]]:
    """Read the files of a folder as one experiment, the tests in order; return also why files were skipped."""
    files = [Path(folder)] if isinstance(folder, str | Path) else [Path(each) for each in folder]
    if isinstance(folder, str | Path):
        if not files[0].is_dir():
            raise errors.InputError(f"{folder} is no folder; name one with measurement files (TOML)")
        files = sorted(files[0].glob("*.toml"))
    read: dict[Path, Experiment] = {}
    skipped: list[str] = []
    for file in files:
        try:
            found = load(file)
            with checks.named(str(file)):
                refuse_mistakes(found)
            read[file] = found
        except errors.CvxshearError as error:
            skipped.append(str(error))
    tests = [test for file, each in read.items() for test in _named(file, each)]
    if len(tests) < FEWEST_TESTS:
        why = f"; skipped: {'; '.join(skipped)}" if skipped else ""
        raise errors.InputError(f"a history needs {FEWEST_TESTS} tests, found {len(tests)} in {folder}{why}")
    (first, model), *others = read.items()
    for file, each in others:
        for key in ("frame", "prior"):
            mine, its = (experiment.to_dict().get(key) for experiment in (model, each))
            if repr(mine) != repr(its):
                raise errors.InputError(f"{file} declares another {key} than {first}; one history has one frame")
    dates = _dates(tests)
    order = range(len(tests)) if dates is None else np.argsort(dates, kind="stable")
    frame = replace(model.frame, reference=None)
    name = Path(folder).resolve().name if isinstance(folder, str | Path) else model.name
    return Experiment(frame, tuple(tests[at] for at in order), model.priors, name), tuple(skipped)


def _named(file: Path, experiment: Experiment) -> list[Configuration]:
    """Return the tests of a file, named after the file, each a state of its own."""
    several = len(experiment.configurations) > 1
    names = [
        f"{named_after(file)}: {each.name}" if several else named_after(file) for each in experiment.configurations
    ]
    return [replace(each, name=name, state=name) for each, name in zip(experiment.configurations, names, strict=True)]


def _of_all(tests: Sequence[Configuration], key: str) -> list[Any]:
    """Return a value of all tests; empty if no test has one."""
    values = [getattr(each, key) for each in tests]
    missing = [each.name for each, value in zip(tests, values, strict=True) if value is None]
    if missing and len(missing) < len(tests):
        raise errors.InputError(f"{key} is missing in {quantities.listed(missing)}; give it in every test or in none")
    return [] if missing else values


def _dates(tests: Sequence[Configuration]) -> list[float] | None:
    """Return the dates in days since the year 1; None without dates."""
    times = [datetime.fromisoformat(each).replace(tzinfo=None) for each in _of_all(tests, "date")]
    return [(each - datetime.min).total_seconds() / 86400.0 for each in times] or None


def _centred(course: Floats) -> Floats:
    """Move a course so that zero is in the middle of its range."""
    return np.asarray(course - 0.5 * (course.max() + course.min()))


def _alone(found: LoopResult, test: Configuration, solver: backends.Backend) -> tuple[Floats, Floats]:
    """Identify the story stiffnesses of one test with the masses and the noise of the loop; nan if it cannot."""
    noise, frame = found.estimate.misfit.noise, found.experiment.frame
    table = test.to_dict() | {"frequency_std": test.log_frequency_std * noise.of("frequency")}
    if test.measured.any():
        std = DEFAULT_MODE_SHAPE_STD if test.mode_shape_std is None else test.mode_shape_std
        table["mode_shape_std"] = np.full(test.mode_shapes.shape, std) * noise.of("mode_shape")
    known = {"floor_masses": found.averaged.floor_mass, "story_heights": frame.story_heights}
    priors = [each for each in found.experiment.priors if each.quantity == "story_stiffness"]
    try:
        alone = Experiment.from_dict({"frame": known, "configuration": [table]}).with_priors(priors)
        identified = efficient(alone, solver).frame
    except errors.CvxshearError:
        unknown = np.full(found.experiment.stories, np.nan)
        return unknown, unknown
    return identified.story_stiffness, identified.story_stiffness_std


def _change(item: AddedEffect) -> StiffnessChange:
    """Describe one added trend; steps of the same stories at other tests are the same step."""
    place, p, std = _trend(item.placed.place), item.parameters["p"], item.std["p"] or np.nan
    same = [
        each
        for each in item.rivals
        if place.kind == _trend(each.placed.place).kind == "step" and each.placed.place.story == place.story
    ]
    size, deviation = place.sized(p, std)
    return StiffnessChange(
        kind=place.kind,
        story=place.story,
        test=place.first,
        probability=min(item.probability + sum(each.probability for each in same), 1.0),
        size=size,
        std=deviation,
        text=place.words(p, std),
        other_tests=tuple(str(_trend(each.placed.place).first) for each in same),
        rivals=tuple(each.placed.label for each in item.rivals if each not in same),
    )
