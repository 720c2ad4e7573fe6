"""Compare identified modes with a known frame's, and the stated deviations with the observed scatter.

Run `python -m tests.studies records` for the figures in docs/modal.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cvxshear.records.identify import identify_modes
from cvxshear.records.picking import scaled_to_one
from cvxshear.records.record import TimeRecord
from cvxshear.records.result import ModalResult
from cvxshear.records.simulate import PAPER_FRAME, KnownFrame, ambient_record, base_record, hammer_record
from cvxshear.util.typing import Floats, Json

MAKERS: dict[str, Callable[..., TimeRecord]] = {"hammer": hammer_record, "base": base_record, "ambient": ambient_record}


@dataclass(frozen=True, eq=False)
class RecordScatter:
    """Errors and stated standard deviations over seeded repetitions.

    Parameters
    ----------
    frequency_errors : array, shape (seeds, m)
        Relative errors.
    shape_errors : array, shape (seeds, m, n)
        Errors of the entries, with each mode's largest entry scaled to 1.
    frequency_stds : array, shape (seeds, m)
        Stated relative deviations.
    shape_stds : array, shape (seeds, m, n)
        Stated deviations.
    results : list of ModalResult
    """

    frequency_errors: Floats
    shape_errors: Floats
    frequency_stds: Floats
    shape_stds: Floats
    results: list[ModalResult]

    def stated_over_seen(self) -> tuple[Floats, Floats]:
        """Root mean square stated standard deviation over the observed one.

        Returns
        -------
        frequencies : array, shape (m,)
        entries : array, shape (m, n)
            nan for entries that are 1 by definition.
        """
        frequency = np.sqrt(np.mean(self.frequency_stds**2, axis=0)) / self.frequency_errors.std(axis=0, ddof=1)
        seen = self.shape_errors.std(axis=0, ddof=1)
        stated = np.sqrt(np.mean(self.shape_stds**2, axis=0))
        return frequency, np.where(seen > 1e-12, stated / np.where(seen > 1e-12, seen, 1.0), np.nan)

    def to_dict(self) -> Json:
        """Return the largest and root mean square errors, and the ratios, as plain values."""
        frequency, shape = self.stated_over_seen()
        return {
            "seeds": len(self.results),
            "max_frequency_error": float(np.abs(self.frequency_errors).max()),
            "rms_frequency_error": np.sqrt(np.mean(self.frequency_errors**2, axis=0)).tolist(),
            "max_shape_error": float(np.abs(self.shape_errors).max()),
            "rms_shape_error": np.sqrt(np.mean(self.shape_errors**2, axis=0)).tolist(),
            "frequency_stated_over_seen": frequency.tolist(),
            "shape_stated_over_seen": shape.tolist(),
        }


def scatter(
    kind: str, *, noise: float, seeds: int, frame: KnownFrame = PAPER_FRAME, method: str | None = None, **options: float
) -> RecordScatter:
    """Identify simulated records and compare them with their frame.

    Parameters
    ----------
    kind : str
        "hammer", "base" or "ambient".
    noise : float
        Sensor noise relative to each channel's standard deviation.
    seeds : int
        Number of repetitions, with seeds 0, 1, ....
    frame : KnownFrame, optional
    method : str, optional
    **options
        Options of the record maker: duration, sampling_rate, hits, ....

    Returns
    -------
    RecordScatter
    """
    frequencies, normalized = frame.modes()
    shapes = np.array([scaled_to_one(shape) for shape in normalized])
    results = [
        identify_modes(MAKERS[kind](frame, seed, noise=noise, **options), method=method) for seed in range(seeds)
    ]
    found = np.array([result.frequencies for result in results])
    places = np.argmax(np.abs(shapes), axis=1)
    rows = np.arange(len(shapes))
    real = np.array([result.mode_shapes / result.mode_shapes[rows, places][:, None] for result in results])
    return RecordScatter(
        found / frequencies - 1,
        real - shapes,
        np.array([result.frequency_std for result in results]),
        np.array([_std_at_one(result) for result in results]),
        results,
    )


def _std_at_one(result: ModalResult) -> Floats:
    """Return standard deviations of shape entries with the largest entry scaled to 1, shape (m, n).

    The joint covariance gives d(phi_i / phi_p) = (d phi_i - phi_i / phi_p d phi_p) / phi_p.
    """
    modes, floors = result.mode_shapes.shape
    std = np.zeros((modes, floors))
    for r, shape in enumerate(result.mode_shapes):
        scaled = scaled_to_one(shape)
        place = int(np.argmax(np.abs(shape)))
        start = modes + r * floors
        block = result.covariance[start : start + floors, start : start + floors]
        jacobian = np.eye(floors)
        jacobian[:, place] -= scaled
        std[r] = np.sqrt(np.maximum(np.diag(jacobian @ block @ jacobian.T), 0.0))
    return std


def main() -> None:
    """Print the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--kinds", nargs="*", default=sorted(MAKERS), choices=sorted(MAKERS))
    parser.add_argument("--noise", type=float, nargs="*", default=[0.01, 0.05])
    parser.add_argument("--method")
    chosen = parser.parse_args()
    for kind in chosen.kinds:
        for noise in chosen.noise:
            _print(kind, noise, scatter(kind, noise=noise, seeds=chosen.seeds, method=chosen.method))


def _print(kind: str, noise: float, found: RecordScatter) -> None:
    frequency, shape = found.stated_over_seen()
    print(
        f"{kind:8} {100 * noise:3.0f} % noise, {len(found.results)} seeds: "
        f"frequencies rms {_percent(np.sqrt(np.mean(found.frequency_errors**2, axis=0)))} "
        f"largest {100 * np.abs(found.frequency_errors).max():.4f} %; "
        f"entries rms {_percent(np.sqrt(np.mean(found.shape_errors**2, axis=(0, 2))))} "
        f"largest {100 * np.abs(found.shape_errors).max():.3f} %; "
        f"stated over seen: frequencies {np.round(frequency, 2).tolist()}, "
        f"entries {np.round(shape[np.isfinite(shape)], 2).tolist()}"
    )


def _percent(values: Floats) -> str:
    return "(" + ", ".join(f"{100 * value:.4f}" for value in values) + ") %"


if __name__ == "__main__":
    main()
