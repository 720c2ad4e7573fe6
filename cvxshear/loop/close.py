"""Closing the loop: the shear model, the sets of effects that it may lack, and what the data say of them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import Effect, Placed, Scale, catalogue, open_classes
from cvxshear.effects.guests import refuse_faulty, refuse_repeated
from cvxshear.effects.state import heights_of
from cvxshear.fit.efficient import Estimate, efficient
from cvxshear.fit.expectation import Expectation
from cvxshear.fit.gauss_newton import FULL, ROUGH, Accuracy
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import nearest_start
from cvxshear.loop.conclusion import conclude
from cvxshear.loop.fitter import Fitter, ModelClass
from cvxshear.loop.hypotheses import Hypothesis, assumed, chosen, hypotheses
from cvxshear.loop.numbering import Numbering
from cvxshear.loop.otherwise import searches
from cvxshear.loop.results import Closure
from cvxshear.loop.search import REACH, Search
from cvxshear.loop.twins import dual_fits_as_well, dual_frame, dual_set, few_floors_seen
from cvxshear.loop.verdicts import VERDICTS
from cvxshear.measurement.experiment import Experiment, Measurement, opened
from cvxshear.measurement.reading import repeated_configurations
from cvxshear.priors import Prior
from cvxshear.util.errors import CvxshearError, InputError, NoSolutionError, UnsuitableError
from cvxshear.util.typing import Floats

SAME_FRAME = 1e-3
"""Relative difference of masses and stiffnesses below which two fits have one frame: fits end closer than that."""

MOST_PAIRED = 10
"""Stories up to which all pairs of changes of a state are tried: 180 fits a state."""

MOST_WIDENINGS = 3
"""Times that the noise is widened where nothing explains a residual: under wider noise other sets are best."""


def close_loop(
    experiment: Measurement,
    effects: Sequence[str | Effect] | None = None,
    assume: Sequence[str | Placed] = (),
    backend: str | Backend = "auto",
    priors: Sequence[Prior] = (),
    *,
    jobs: int = 1,
) -> Closure:
    """Find the physical effects that the shear model lacks.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in
    effects : sequence of str or Effect, optional
        Which effects to look for, names or objects of your own; the whole catalogue where not given. An object brings
        its own probability and expected size (`Effect.expecting`).
    assume : sequence of str or Placed, optional
        Effects that are in the model from the start.
    backend : str or Backend, optional
    priors : sequence of Prior, optional
        Besides those of the experiment.
    jobs : int, optional
        Processes over which sets of effects are fitted; -1 takes every core.

    Returns
    -------
    Closure

    Raises
    ------
    InputError
        Where an effect is not known, cannot be assumed for this experiment, or does not say how large it may be. As
        `cvxshear.close_loop` also where `cvxshear.screening` finds a mistake that the file does not accept, such as
        exchanged sensors.
    NoSolutionError
        Where the shear model itself could not be fitted by this backend.
    """
    experiment, repeated = without_repeated(opened(experiment).with_priors(tuple(priors)))
    wanted, left_out = _sound(chosen(effects), experiment)
    solver = backends.get(backend)
    there = _declared(experiment, solver, assumed(experiment, assume))
    looked_for = hypotheses(experiment, wanted, there)
    start = _first(experiment, solver, there)
    declared = loop = _Loop(solver, there, looked_for, _expectation(experiment, start.theta, looked_for), start, jobs)
    found = searches(experiment, loop.begun, loop.dual)
    said = (
        *(f'"{name}" repeats "{same}" to the last digit: both count as one test' for name, same in repeated),
        *(f"an effect was left out: {message}" for message in left_out),
    )
    result = conclude(found, looked_for, wanted, said=said)
    for _ in range(MOST_WIDENINGS):
        if not VERDICTS[result.verdict].provisional or not (excess := _excess(loop, result)):
            break
        # Evidence under noise that the residual refutes is none: the sets are judged again under as much as it takes.
        loop = dataclasses.replace(loop, widened=loop.widened * excess)
        again = searches(experiment, loop.begun, loop.dual)
        numbered = [each.fitter.numbering.changes for each in found]
        # Numbers of the modes that only the wider noise makes probable: their fit to the noise as declared is stated.
        new = {each.fitter.numbering.changes: each.fitter.numbering for each in again}
        found += [declared.begun(each) for changes, each in new.items() if changes not in numbered]
        result = conclude(found, looked_for, wanted, said=said, widened=again)
    return result


def begun(experiment: Experiment, there: tuple[Placed, ...] = ()) -> Search:
    """Begin a search over the whole catalogue with the fit of the shear model; no effect is tried.

    Parameters
    ----------
    experiment : Experiment
    there : tuple of Placed, optional
        Effects that are in the model from the start.

    Raises
    ------
    CvxshearError
        Where the shear model could not be fitted.
    """
    solver = backends.get("auto")
    looked_for = hypotheses(experiment, chosen(None), there)
    start = _first(experiment, solver, there)
    expectation = _expectation(experiment, start.theta, looked_for)
    return _Loop(solver, there, looked_for, expectation, start, 1).begun(Numbering(experiment))


def _sound(wanted: Sequence[Effect], experiment: Experiment) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """Find the effects that can take part, and why others, of one's own, cannot.

    Raises
    ------
    InputError
        Where two go by one name, or none of several can take part.
    """
    refuse_repeated(wanted)
    own = {id(effect) for effect in (*catalogue(), *open_classes())}
    sound: list[Effect] = []
    messages = []
    for effect in wanted:
        try:
            if id(effect) not in own:
                refuse_faulty(effect, experiment)
            sound.append(effect)
        except InputError as error:
            if len(wanted) == 1:
                raise
            messages.append(str(error))
    return tuple(sound), tuple(messages)


def without_repeated(experiment: Experiment) -> tuple[Experiment, tuple[tuple[str, str], ...]]:
    """Return the experiment with each test once, and the names of the copies with that of the test they repeat.

    Measured values that agree to the last digit are one measurement: counted twice they would seem twice as sure.
    """
    groups = repeated_configurations(experiment)
    kept = {each.name for each in experiment.configurations if each.state == experiment.frame.reference}
    repeated = tuple((name, first) for first, *others in groups for name in others if name not in kept)
    copies = {name for name, _ in repeated}
    if not copies:
        return experiment, ()
    once = tuple(each for each in experiment.configurations if each.name not in copies)
    states = {each.state for each in once} | {each.state for each in experiment.static}
    expected = tuple(each for each in experiment.expected if each.state is None or each.state in states)
    return dataclasses.replace(experiment, configurations=once, expected=expected), repeated


def _excess(loop: _Loop, result: Closure) -> float | None:
    """By how much the noise must be widened for the residual to be probable; None where it is."""
    judged = result.judged
    return float(np.sqrt(judged.fit.at.chi2 / max(judged.dof, 1))) if judged.improbable else None


@dataclass(frozen=True)
class _Loop:
    """What all searches of one loop share."""

    backend: Backend
    there: tuple[Placed, ...]
    looked_for: Sequence[Hypothesis]
    expectation: Expectation
    start: Estimate
    jobs: int
    widened: float = 1.0

    def begun(self, numbering: Numbering) -> Search:
        """Begin a search under one numbering of the modes, its shear model fitted."""
        theta = self.start.theta
        if numbering.changes:
            theta = nearest_start(Misfit(numbering.experiment, self.there))
        return self._search(numbering, theta, ROUGH if numbering.changes else FULL)

    def _search(self, numbering: Numbering, theta: Floats, accuracy: Accuracy) -> Search:
        fitter = Fitter(numbering, self.backend, self.looked_for, self.there, self.expectation, jobs=self.jobs)
        noise = self.start.misfit.noise
        misfit = Misfit(numbering.experiment, self.there, None, noise, self.expectation, self.widened)
        try:
            found = fitter.fit(misfit, theta, accuracy)
        except NoSolutionError:
            # Far from the data a fit may follow a curved valley without an end; effects are looked for from there, too.
            found = fitter.fit(misfit, theta, ROUGH)
        return Search(fitter, found)

    def dual(self, search: Search) -> Search | None:
        """Visit what frequencies alone leave open: sets with frames far from that of the search.

        Where no datum tells a frame from its dual, begin the search that starts at the dual of the shear model; None
        elsewhere, and where the dual start leads to the same frame.
        """
        numbering = search.fitter.numbering
        if search.base.estimate is None or not few_floors_seen(numbering.experiment):
            return None
        best = search.best
        pairs = self._pairs(search)
        search.visit(pairs)
        typical = np.median(search.base.estimate.theta[: 2 * numbering.experiment.stories].reshape(2, -1), axis=1)
        even = np.repeat(typical, numbering.experiment.stories)
        found = search.visit_from([*self._duals(search), *self._changes(search)])
        if search.visit_from([(each, even) for each in pairs]) or found or search.best is not best:
            search.run()
        while search.visit_exchanges():
            search.run()
        if not dual_fits_as_well(numbering.experiment):
            return None
        theta = search.base.estimate.theta.copy()
        frame = theta[: 2 * numbering.experiment.stories]
        frame[:] = dual_frame(frame)
        try:
            other = self._search(numbering, theta, FULL)
        except CvxshearError:
            # What was declared of the frame excludes its dual.
            return None
        if other.base.score < search.base.score - REACH or _same_frame(other.base, search.base):
            return None
        other.visit(effects for effects, _ in self._duals(search))
        other.run()
        search.visit(effects for effects, _ in self._duals(other))
        return other

    def _duals(self, search: Search) -> list[tuple[frozenset[Placed], Floats]]:
        """List the duals of the best sets of a search, each with the dual of the frame that it has with its set."""
        n = search.fitter.experiment.stories
        known = [item.placed for item in self.looked_for]
        return [
            (dual, dual_frame(model.estimate.theta[: 2 * n]))
            for model in search.beam
            if model.estimate is not None and (dual := dual_set(model.effects, known, n)) is not None
        ]

    def _pairs(self, search: Search) -> list[frozenset[Placed]]:
        """List two changes of a kind in one state: two that are seen only together are seen by no step towards one."""
        n = search.fitter.experiment.stories
        placed = [item.placed for item in self.looked_for if item.placed.effect.dual(item.placed.place, n) is not None]
        return [
            frozenset([a, b])
            for a, b in itertools.combinations(placed if n <= MOST_PAIRED else (), 2)
            if (a.effect.name, a.place.state) == (b.effect.name, b.place.state)
        ]

    def _changes(self, search: Search) -> list[tuple[frozenset[Placed], Floats]]:
        """List every change of a state that has a dual, from the frame of each state by itself, and from its dual.

        The shear model of all states together lies between their frames, and may be nearer to another minimum.
        """
        base, experiment = search.base.estimate, search.fitter.experiment
        assert base is not None, "the shear model was fitted"
        n = experiment.stories
        placed = [item.placed for item in self.looked_for if item.placed.effect.dual(item.placed.place, n) is not None]
        frames = []
        for state in experiment.states if placed else ():
            left_out = {
                each.name: np.ones(len(each.frequencies), dtype=bool)
                for each in experiment.configurations
                if each.state != state
            }
            misfit = Misfit(experiment, self.there, left_out, base.misfit.noise, self.expectation, self.widened)
            frame = search.fitter.fit(misfit, base.theta, ROUGH).theta[: 2 * n]
            frames += [frame, dual_frame(frame)]
        return [(frozenset([each]), frame) for each in placed for frame in frames]


def _same_frame(a: ModelClass, b: ModelClass) -> bool:
    """Whether two fits have one frame: from another, even one that no datum tells from it, other sets are reached."""
    assert a.estimate is not None, "the shear model was fitted"
    assert b.estimate is not None, "the shear model was fitted"
    return bool(np.allclose(a.estimate.theta, b.estimate.theta, rtol=SAME_FRAME))


def _first(experiment: Experiment, backend: Backend, there: tuple[Placed, ...]) -> Estimate:
    """Make the first fit, on the backend that was asked for: one that does not solve it is not fit for the others.

    Only where the backend takes no such programs (active inequalities) another one stands in.
    """
    try:
        return efficient(experiment, backend, there)
    except UnsuitableError:
        if backend.name == "auto":
            raise
        return efficient(experiment, backends.get("auto"), there)


def _declared(experiment: Experiment, backend: Backend, there: tuple[Placed, ...]) -> tuple[Placed, ...]:
    """Return the assumed effects; one that these data do not determine is held at its starting value."""
    if not there:
        return there
    found = _first(experiment, backend, there)
    known = found.uncertainty.determined
    return tuple(
        placed if np.all(known[found.own(placed)]) else Placed(placed.effect, placed.place, placed.start)
        for placed in there
    )


def _expectation(experiment: Experiment, theta: Floats, looked_for: Sequence[Hypothesis]) -> Expectation:
    """Gather what is expected of effects and frame, in units of a typical floor and story of a first fit."""
    n = experiment.stories
    mass, stiffness = np.median(theta[:n]), np.median(theta[n : 2 * n])
    scale = Scale(float(mass), float(stiffness), heights_of(experiment))
    stds = {
        item.placed: item.placed.effect.expecting(size=item.size).expected_sizes(scale)
        for item in looked_for
        if item.size is not None
    }
    found = Expectation(scale, stds)
    for item in looked_for:
        for parameter, std in zip(item.placed.effect.parameters, found.of(item.placed), strict=True):
            if np.isinf(std) and np.isinf(parameter.upper - parameter.lower):
                raise InputError(
                    f"nothing says how large {parameter.name} of the effect {item.placed.effect.name} may be: give the "
                    "effect `sizes`, or the parameter finite bounds"
                )
    return found
