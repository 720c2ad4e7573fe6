"""The damping of an identified frame: modal, by story dashpots, or Rayleigh's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.fit.efficient import Estimate
from cvxshear.measurement.opened import Measurement, opened
from cvxshear.response.dashpots import LEAST_RATIO, MISSED, known
from cvxshear.response.fitted import Fitted
from cvxshear.response.uncertain import Damped, UncertainFrame, propagated
from cvxshear.util import checks
from cvxshear.util.quantities import percent, ranged
from cvxshear.util.results import Shown
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedDamping(Shown):
    """Damping with its standard deviations.

    Parameters
    ----------
    kind : str
        "modal", "story" or "rayleigh".
    ratios, ratios_std : ndarray, shape (N,)
        Of the model's modes; standard deviations as fractions of critical, nan where unknown.
    story_dashpot, story_dashpot_std : ndarray, shape (N,), optional
        N s/m; nan where the data leave a dashpot open. Only of story damping.
    rayleigh, rayleigh_std : ndarray, shape (2,), optional
        a (1/s) and b (s). Only of Rayleigh damping.
    measured : ndarray, shape (N,), optional
        The ratios that were measured, nan where none was.
    remarks : tuple of str
        What was assumed, and what the data leave open.
    """

    kind: str
    ratios: Floats
    ratios_std: Floats
    story_dashpot: Floats | None = None
    story_dashpot_std: Floats | None = None
    rayleigh: Floats | None = None
    rayleigh_std: Floats | None = None
    measured: Floats | None = None
    remarks: tuple[str, ...] = ()

    json_keys = (
        "kind story_dashpot story_dashpot_std ratios ratios_std ratios_measured=measured rayleigh rayleigh_std remarks"
    )


def parts_of(damped: Damped) -> Floats:
    """Return the damping's own numbers in one vector: ratios, then dashpots or Rayleigh's factors."""
    parts = [damped.model.ratios]
    if damped.dashpots is not None:
        parts.append(damped.dashpots.values)
    if damped.rayleigh is not None:
        parts.append(damped.rayleigh)
    return np.concatenate(parts)


def described(frame: UncertainFrame, damped: Damped, std: Floats) -> IdentifiedDamping:
    """Return the damping with standard deviations of `parts_of`."""
    n = len(damped.model.M)
    ratios, own = std[:n], std[n:]
    remarks = [*frame.ratios.assumed()]
    if frame.ratios.tested.name != frame.configuration.name:
        remarks.append(f'the damping ratios were measured in "{frame.ratios.tested.name}"')
    if frame.fitted.experiment.damping.priors and frame.kind != "story":
        remarks.append(f"the priors on story_damping have no part in {frame.kind} damping")
    measured = np.where(frame.ratios.measured, frame.ratios.values, np.nan)
    factors, dashpots, dashpot_std = damped.rayleigh, None, None
    if damped.dashpots is not None:
        dashpots = damped.dashpots.values
        dashpot_std = np.where(damped.dashpots.determined, own, np.nan)
        if damped.dashpots.open:
            remarks.append(
                f"the measured damping ratios leave open {', and '.join(damped.dashpots.open)}; what is left open is "
                "set in proportion to the story stiffness"
            )
    if frame.kind != "modal":
        remarks += _missed(frame, damped, measured)
    return IdentifiedDamping(
        frame.kind, damped.model.ratios, ratios, dashpots, dashpot_std, factors,
        None if factors is None else own, measured, tuple(remarks),
    )  # fmt: skip


def _missed(frame: UncertainFrame, damped: Damped, measured: Floats) -> list[str]:
    """Name the measured ratios that this kind of damping does not have, and which kind would."""
    std = frame.ratios.std * np.maximum(frame.ratios.values, LEAST_RATIO)
    far = np.flatnonzero(np.abs(damped.model.ratios - np.nan_to_num(measured)) > MISSED * std)
    modes = [int(mode) + 1 for mode in far if np.isfinite(measured[mode])]
    if not modes:
        return []
    own = np.maximum(damped.model.ratios, 1e-9)
    worst = max(modes, key=lambda mode: abs(np.log(own[mode - 1] / max(measured[mode - 1], 1e-9))))
    return [
        f"{WORDS[frame.kind]} cannot give the measured damping ratio{'s' if len(modes) > 1 else ''} of mode "
        f"{ranged(modes)} (mode {worst}: {percent(float(damped.model.ratios[worst - 1]), 2)} in place of "
        f"{percent(float(measured[worst - 1]), 2)}); modal damping can"
    ]


WORDS = {"story": "dashpots between the floors", "rayleigh": "Rayleigh damping"}
"""Kinds of damping that need not have the measured ratios."""


def damping_of(
    experiment: Measurement,
    estimate: Estimate | Fitted,
    backend: str | Backend = "auto",
    *,
    kind: str | None = None,
    configuration: str | None = None,
) -> IdentifiedDamping | None:
    """Find the damping of an identified frame from the damping ratios that its experiment declares.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in
    estimate : Estimate or Fitted
        Of `identification.efficient`, or of a closed loop.
    backend : str or Backend, optional
    kind : str, optional
        "modal", "story" or "rayleigh"; what the experiment declares where not given.
    configuration : str, optional
        Which state; the first with damping ratios where not given.

    Returns
    -------
    IdentifiedDamping or None
        None where no damping ratio is declared.

    Raises
    ------
    InputError
        Where there is no configuration of that name.
    UnsuitableError
        Where Rayleigh damping is asked for and one ratio is known.
    """
    experiment = opened(experiment)
    if not known(experiment):
        return None
    names = [each.name for each in experiment.configurations if each.damping_ratios is not None]
    name = names[0] if configuration is None else checks.choice(configuration, names, "configuration")
    state = next(each for each in experiment.configurations if each.name == name)
    fitted = estimate if isinstance(estimate, Fitted) else Fitted.of(estimate)
    frame = UncertainFrame.of(fitted, state, kind, backends.get(backend))
    if frame.kind == "modal":
        # The ratios are what was measured; nothing else has a part in them.
        return described(frame, frame.at(np.zeros(frame.size)), frame.ratios.values * frame.ratios.std)
    centre, std = propagated(frame, parts_of)
    return described(frame, centre, std)
