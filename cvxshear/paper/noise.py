"""Section 5.2: the three-story frame from noisy modes, Table 3 and Fig. 6."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cvxshear.paper import tables
from cvxshear.paper.results import Row, Section
from cvxshear.studies.noise import NoiseStudy, noise_study, paper_setups

FIGURE_6_SAMPLES = 2000
UNLIKELY = 1.96
"""Standard errors that chance exceeds in one case of twenty."""

BEYOND_CHANCE = 3.5
"""Standard errors that the largest of 30 figures exceeds in one case of seventy."""


def sections(samples: Sequence[int], seed: int) -> Iterator[Section]:
    """Table 3 with each number of samples, and Fig. 6.

    Parameters
    ----------
    samples : sequence of int
    seed : int
    """
    for count in samples:
        study = noise_study(paper_setups(tuple(tables.TABLE_3)), ("two-stage",), count, seed)
        rows = tuple(_table_3(study))
        title = f"Table 3: error of the mean, {count:,} samples"
        yield Section(title, rows, (_chance(rows), *_systematic(study)))
    yield _figure_6(noise_study(paper_setups((tables.FIGURE_6_SIGMA,)), ("two-stage",), FIGURE_6_SAMPLES, seed))


def _table_3(study: NoiseStudy) -> Iterator[Row]:
    for scatter, (sigma, printed) in zip(study.scatters, tables.TABLE_3.items(), strict=True):
        spread = scatter.errors.std(axis=0, ddof=1)
        # The paper's mean and ours are of samples that have nothing to do with each other.
        chance = spread * np.sqrt(1 / tables.TABLE_3_SAMPLES + 1 / study.samples)
        for place, name in enumerate(tables.PARAMETERS):
            yield Row(
                what=f"{name}, %",
                where=f"Table 3, σ = {sigma:g}",
                printed=printed[place],
                recomputed=100 * float(scatter.bias[place]),
                std_error=100 * float(scatter.bias_error[place]),
                chance=100 * float(chance[place]),
            )


def _chance(rows: Sequence[Row]) -> str:
    distances = np.array([row.distance for row in rows if row.distance is not None])
    beyond = int(np.sum(np.abs(distances) > UNLIKELY))
    farthest = float(np.max(np.abs(distances)))
    explained = "explains" if farthest < BEYOND_CHANCE else "does not explain"
    return (
        f"A mean of {tables.TABLE_3_SAMPLES} samples scatters: of {len(rows)} printed errors {beyond} lie more than "
        f"{UNLIKELY:g} standard errors from ours ({0.05 * len(rows):.1f} expected by chance), the farthest "
        f"{farthest:.1f}. Chance {explained} the printed figures."
    )


def _systematic(study: NoiseStudy) -> Iterator[str]:
    """The bias that is left when chance is averaged out, where the samples suffice to see one."""
    scatter = study.scatters[-1]
    seen = np.flatnonzero(np.abs(scatter.bias) > 3 * scatter.bias_error)
    if seen.size:
        listed = ", ".join(
            f"{tables.PARAMETERS[i]} {100 * scatter.bias[i]:+.2f} ± {100 * scatter.bias_error[i]:.2f} %" for i in seen
        )
        yield (
            f"At σ = {scatter.setup.mode_shape_std:g} a bias is seen beyond three standard errors: {listed}. It is "
            "small beside the scatter, and under 1 % as the paper says."
        )


def _figure_6(study: NoiseStudy) -> Section:
    scatter = study.scatters[0]
    sigma = scatter.setup.mode_shape_std
    variation = 100 * scatter.variation
    rows = tuple(
        Row(
            what=f"{name}, %",
            where=f"Fig. 6, σ = {sigma:g}",
            printed=tables.FIGURE_6,
            recomputed=float(found),
            # Of the standard deviation of normal samples.
            std_error=float(found / np.sqrt(2 * study.samples)),
        )
        for name, found in zip(tables.PARAMETERS, variation, strict=True)
    )
    largest = int(np.argmax(variation))
    return Section(
        f"Fig. 6: coefficients of variation, {study.samples:,} samples",
        rows,
        (
            f"The paper says that an error of the modes is not enlarged. For {tables.PARAMETERS[largest]} it is, "
            f"{variation[largest] / (100 * sigma):.1f} times.",
        ),
    )
