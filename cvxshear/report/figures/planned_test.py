"""Draw a planned test: the frame with its sensors and masses, and the accuracy against the number of sensors."""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from cvxshear.planning.results import Plan, accuracy_curve
from cvxshear.report.figures.figure_table import figure
from cvxshear.report.figures.style import AFTER, BEFORE, GREY, PALE, letters, new_figure

STORY = 0.24
"""Least height of a story, inch."""

LABEL_LETTERS = 24
"""Largest number of letters of a label beside the lowest drawn frame."""

TEST_WIDTH = 0.9
"""Width of a test, inch: enough for its name."""


@figure(
    "plan",
    Plan,
    title="The planned tests",
    alternative="Sensors and added masses of each test, and accuracy over the number of sensors.",
    section="tests",
)
def plan(result: Plan) -> Figure:
    """Draw the frame of each test with its added masses and sensors, and accuracy against number of sensors.

    Left: the frame of each test with its sensors and the masses to add. Right: the expected accuracy over the
    number of sensors, with the bound below which no choice can be.
    """
    shown = min(len(result.tests), MOST_SHOWN)
    n = result.model.design.stories
    frames = max(2.2, TEST_WIDTH * shown + 0.8)
    figure = new_figure(frames + 3.8, float(np.clip(n * STORY + 1.2, 2.8, 10.0)))
    left, right = figure.subplots(1, 2, width_ratios=[frames, 3.6])
    _frames(left, result, shown)
    _curve(right, result)
    return figure


MOST_SHOWN = 6
"""Number of drawn tests; the table lists all."""


def _frames(axes: Axes, result: Plan, shown: int) -> None:
    n = result.model.design.stories
    heaviest = max(*(float(test.max()) for test in result.tests), 1e-300)
    for place, test in enumerate(result.tests[:shown]):
        for floor in range(1, n + 1):
            for side in (place - 0.3, place + 0.3):
                axes.plot([side, side], [floor - 1, floor], color=GREY, lw=1.2)
            axes.add_patch(Rectangle((place - 0.33, floor - 0.06), 0.66, 0.12, fc=PALE, ec="black", lw=0.7, zorder=3))
            mass = float(test[floor - 1])
            if mass > 0:
                tall = 0.5 * mass / heaviest
                load = {"fc": BEFORE, "ec": "black", "lw": 0.6, "hatch": "//", "zorder": 3}
                axes.add_patch(Rectangle((place - 0.16, floor + 0.06), 0.32, tall, **load))  # type: ignore[arg-type]
            if floor in result.sensors:
                axes.plot(place + 0.24, floor + 0.16, "o", color=AFTER, ms=4.5, zorder=4)
        axes.plot([place - 0.4, place + 0.4], [0, 0], color="black", lw=1.2)
    axes.plot([], [], "o", color=AFTER, label="sensor")
    axes.add_patch(Rectangle((0, 0), 0, 0, fc=BEFORE, ec="black", hatch="//", label=f"mass, at most {heaviest:.3g} kg"))
    axes.set_xticks(range(shown), [letters(name.removeprefix("planned "), 11) for name in result.names[:shown]])
    step = 1 if n <= 20 else 5
    axes.set_yticks([1, *range(step, n + 1, step)] if step > 1 else range(1, n + 1))
    axes.set_ylabel("floor")
    axes.set_xlim(-0.6, shown - 0.4)
    axes.set_ylim(-0.1, n + 0.8)
    axes.tick_params(axis="x", length=0)
    axes.spines[["bottom", "left"]].set_visible(False)
    handles, names = axes.get_legend_handles_labels()
    kept = len(handles) if heaviest > 1e-300 else 1
    axes.legend(handles[:kept], names[:kept], loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=2)


def _curve(axes: Axes, result: Plan) -> None:
    curve = accuracy_curve(result)
    counts = [count for count, _, _ in curve]
    axes.plot(counts, [100 * value for _, value, _ in curve], "o-", color=AFTER, label="best found")
    axes.plot(counts, [100 * bound for _, _, bound in curve], "--", color=GREY, label="no choice below")
    axes.plot(len(result.sensors), 100 * result.objective, "s", color=BEFORE, ms=7, label="plan", zorder=4)
    axes.set_xlabel("number of sensors")
    axes.set_ylabel("\n".join(textwrap.wrap(f"{result.measure}, %", LABEL_LETTERS)))
    axes.set_ylim(0, 115 * max(value for _, value, _ in curve))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(visible=True)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
