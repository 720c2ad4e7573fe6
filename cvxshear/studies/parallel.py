"""Many identifications, over processes or a cluster, for methods that have no closed form over a batch."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np

from cvxshear.measurement.experiment import Experiment
from cvxshear.methods import Identification, identify
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.parallel import Progress, each
from cvxshear.util.typing import Floats


def identify_many(
    experiments: Iterable[Experiment],
    method: str = "efficient",
    backend: str = "auto",
    *,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Identification | NoSolutionError]:
    """`identify` for each of many experiments; where no solution was found the error stands in its place.

    Parameters
    ----------
    experiments : iterable of Experiment
    method, backend : str, optional
        As for `identify`.
    jobs : int, optional
    progress : callable, optional
        As for `each`.

    Raises
    ------
    UnsuitableError, InfeasibleError
        Where a method cannot use an experiment, or its statements contradict each other.
    """
    return each(partial(_identified, method=method, backend=backend), experiments, jobs=jobs, progress=progress)


def _identified(experiment: Experiment, method: str, backend: str) -> Identification | NoSolutionError:
    try:
        return identify(experiment, method, backend)
    except NoSolutionError as error:
        return error


def frames_of(found: Iterable[Identification | NoSolutionError]) -> Floats:
    """Floor masses and story stiffnesses, a row an identification, nan where there is none.

    Parameters
    ----------
    found : iterable
        Of `identify_many`, each with one configuration or a joint fit.

    Returns
    -------
    ndarray, shape (S, 2N)
    """
    rows = [
        None if isinstance(one, NoSolutionError) or one.frame is None
        else np.concatenate([one.frame.floor_mass, one.frame.story_stiffness])
        for one in found
    ]  # fmt: skip
    size = max((len(row) for row in rows if row is not None), default=0)
    return np.array([np.full(size, np.nan) if row is None else row for row in rows])
