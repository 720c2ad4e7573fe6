"""Repeated tests as data: the mean of the frequencies and shapes, and how well it is known.

**Scatter.** Of R repeats of m logarithms of frequencies, S is their sample covariance. A correlation of few repeats is
uncertain: with the prior that makes every correlation uniform between -1 and 1, and leaves the sizes to the data
(inverse Wishart with m + 1 degrees of freedom about the diagonal of S, Barnard et al. 2000), the off-diagonal entries
are (R - 1) / R times the sample's, and the covariance is positive definite for any R. The mean has S / R, times the
square of the ratio of Student's t with R - 1 degrees of freedom to the normal distribution, both at 95 %: intervals of
two standard deviations then hold for few repeats, too. Two repeats give a factor of 6.5 on the deviations, ten 1.15.

**Blocks.** Repeats on several days, or in several laboratories, are a one-way analysis of variance with random effects.
Blocks differ if the mean square between them exceeds the mean square within by an F test at 5 %, for any frequency
(Bonferroni). Then the means of the blocks are the repeats: their scatter contains the variance between the blocks, and
their covariance over the number of blocks is the mean's, however many repeats each block has.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special

from cvxshear.measurement.declaration import InTable
from cvxshear.util import checks, quantities
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats


@dataclass(frozen=True, eq=False)
class Repeats(InTable):
    """Repeated tests of one state, with the same sensors.

    Parameters
    ----------
    frequencies : array_like, shape (R, m)
        Hz, a row a test, R at least 2.
    mode_shapes : array_like, shape (R, m, n), optional
        Any scale and sign; nan where not measured, in every test alike.
    block : sequence of str, shape (R,), optional
        Day, laboratory or operator of each test.

    Raises
    ------
    InputError
    """

    frequencies: Floats
    mode_shapes: Floats | None = None
    block: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        rows = checks.items(self.frequencies, "frequencies", "tests")
        tests = [checks.vector(row, f"frequencies, test {at}", above=0.0) for at, row in enumerate(rows, 1)]
        if len(tests) < 2 or len({len(row) for row in tests}) > 1:
            raise InputError("frequencies must have two tests at least, each with the same number of frequencies")
        put(self, "frequencies", checks.frozen(np.array(tests)))
        same = np.flatnonzero(np.ptp(self.frequencies, axis=0) == 0)
        if same.size:
            raise InputError(
                f"frequency {same[0] + 1} is the same in every test, so that its scatter is unknown: write more "
                "digits, or give frequencies and frequency_std in place of repeats"
            )
        if self.mode_shapes is not None:
            modes = self.frequencies.shape[1]
            shapes = [
                checks.table(each, f"mode_shapes, test {at}", rows=modes, nan=True)
                for at, each in enumerate(checks.items(self.mode_shapes, "mode_shapes", "tests"), 1)
            ]
            if len(shapes) != len(tests) or len({each.shape for each in shapes}) > 1:
                raise InputError(f"mode_shapes must have {len(tests)} tests, each with the same sensors")
            if np.any(np.ptp(np.isnan(shapes).astype(int), axis=0)):
                raise InputError("mode_shapes must have nan at the same entries of every test")
            put(self, "mode_shapes", checks.frozen(np.array(shapes)))
        put(self, "block", tuple(map(str, checks.items(self.block, "block", "names"))))
        if self.block and len(self.block) != len(tests):
            raise InputError(f"block must have {checks.entries(len(tests))}, one a test, not {len(self.block)}")

    def summary(self, *, mass_normalized: bool) -> dict[str, Floats]:
        """Return the keys of a configuration that the repeats replace, with their values.

        Parameters
        ----------
        mass_normalized : bool
            Whether the shapes carry their scales; otherwise the scale of each is free.
        """
        logs = self._independent
        found: dict[str, Floats] = {
            "frequencies": np.exp(logs.mean(axis=0)),
            "frequency_covariance": covariance_of_mean(logs),
        }
        if self.mode_shapes is not None:
            found["mode_shapes"], std = mean_shapes(self.mode_shapes, free=not mass_normalized)
            if std is not None:
                found["mode_shape_std"] = std
        return found

    @cached_property
    def _independent(self) -> Floats:
        """Logarithms of the frequencies of independent repeats: block means if blocks differ."""
        logs = np.log(self.frequencies)
        return np.array([logs[own].mean(axis=0) for own in self._blocks]) if np.any(self.blocks_differ) else logs

    @property
    def _blocks(self) -> list[Bools]:
        """Repeats of each block."""
        return [np.array([each == name for each in self.block]) for name in dict.fromkeys(self.block)]

    @cached_property
    def _mean_squares(self) -> tuple[Floats, Floats, tuple[int, int]]:
        """Mean squares of the logarithms between blocks and within, each of shape (m,); their degrees of freedom."""
        logs, blocks = np.log(self.frequencies), self._blocks
        centres = np.sum([own[:, None] * logs[own].mean(axis=0) for own in blocks], axis=0)
        dof = len(blocks) - 1, len(logs) - len(blocks)
        between = np.sum((centres - logs.mean(axis=0)) ** 2, axis=0) / dof[0]
        return between, np.sum((logs - centres) ** 2, axis=0) / dof[1], dof

    @cached_property
    def blocks_differ(self) -> Bools:
        """For which frequencies the blocks differ by more than their scatter, shape (m,)."""
        count = self.frequencies.shape[1]
        if not 1 < len(self._blocks) < len(self.frequencies):
            return np.zeros(count, dtype=bool)
        between, within, dof = self._mean_squares
        with np.errstate(divide="ignore"):
            p_values = special.fdtrc(*dof, between / within)
        return np.asarray(p_values < (1.0 - quantities.SURE) / count)

    @property
    def between_std(self) -> Floats:
        """Relative standard deviation between blocks of each frequency, shape (m,); zero where they do not differ."""
        if not np.any(self.blocks_differ):
            return np.zeros(self.frequencies.shape[1])
        between, within, dof = self._mean_squares
        sizes = np.array([own.sum() for own in self._blocks])
        typical = (sizes.sum() - np.sum(sizes**2) / sizes.sum()) / dof[0]
        return np.asarray(np.sqrt(np.maximum(between - within, 0.0) / typical))

    def describe(self) -> str:
        """Say how many tests there are, and whether their blocks differ."""
        tests = f"{len(self.frequencies)} repeats"
        if not self.block:
            return tests
        blocks = f"{tests} in {quantities.counted(len(self._blocks), 'block')}"
        if not np.any(self.blocks_differ):
            return f"{blocks}, which do not differ by more than their scatter"
        at = np.flatnonzero(self.blocks_differ)
        sizes = quantities.listed(quantities.percents(self.between_std[at].tolist()))
        return (
            f"{blocks}, which differ by more than their scatter: by {sizes} (standard deviation) in "
            f"{quantities.numbered('frequency', [int(each) + 1 for each in at])}; the mean is known as well as "
            f"{len(self._blocks)} block means tell it"
        )


def student_factor(dof: Floats | int) -> Floats:
    """Return the ratio of the 95 % quantiles of Student's t and of the normal distribution, in the shape of `dof`."""
    tail = 0.5 * (1.0 + quantities.SURE)
    return np.asarray(special.stdtrit(dof, tail) / special.ndtri(tail))


def covariance_of_mean(values: Floats) -> Floats:
    """Compute the covariance of the mean of independent rows, see above.

    Parameters
    ----------
    values : ndarray, shape (R, m)

    Returns
    -------
    ndarray, shape (m, m)
        Positive definite.
    """
    count = len(values)
    S = np.atleast_2d(np.cov(values, rowvar=False))
    shrunk = np.where(np.eye(len(S)) > 0, S, S * (count - 1) / count)
    return np.asarray(shrunk * student_factor(count - 1) ** 2 / count)


def mean_shapes(shapes: Floats, *, free: bool) -> tuple[Floats, Floats | None]:
    """Average repeated shapes, each with its sign and, if that is free, its scale matched to the mean.

    Parameters
    ----------
    shapes : ndarray, shape (R, m, n)
    free : bool

    Returns
    -------
    mean : ndarray, shape (m, n)
        nan where not measured.
    std : ndarray, shape (m, n), or None
        Standard deviation of the mean over the mode's largest entry, one for all entries of a mode; None if one sensor
        with a free scale tells nothing about it.
    """
    known = np.isfinite(shapes[0])
    there = known.any(axis=1)
    filled = np.where(known, shapes, 0.0)
    matched, mean = filled, filled[0]
    # The scales and the mean depend on each other; the first round is right to the noise, the third to its cube.
    for _ in range(3):
        scale = np.sum(filled * mean, axis=2) / np.where(there, np.sum(mean**2, axis=1), 1.0)
        divisor = scale if free else np.sign(scale)
        matched = filled / np.where(divisor == 0, 1.0, divisor)[:, :, None]
        mean = matched.mean(axis=0)
    entries = known.sum(axis=1) - int(free)
    if np.any(entries[there] < 1):
        return np.where(known, mean, np.nan), None
    dof = (len(shapes) - 1) * np.maximum(entries, 1)
    scatter = np.sqrt(np.sum((matched - mean) ** 2, axis=(0, 2)) / dof / len(shapes))
    if np.any(scatter[there] == 0):
        raise InputError(
            f"shape {np.flatnonzero(there & (scatter == 0))[0] + 1} is the same in every test, so that its scatter is "
            "unknown: write more digits, or give mode_shapes and mode_shape_std in place of repeated shapes"
        )
    std = np.where(there, student_factor(dof) * scatter, 1.0) / np.where(there, np.max(np.abs(mean), axis=1), 1.0)
    return np.where(known, mean, np.nan), np.repeat(std[:, None], mean.shape[1], axis=1)
