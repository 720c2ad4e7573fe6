"""Figures of floors that turn, from above, and the page of an identification."""

import numpy as np
import pytest
from matplotlib.patches import Ellipse

import cvxshear
from cvxshear.cli import main
from cvxshear.report import figures
from cvxshear.util.errors import InputError
from tests.fe.plan_frames import random_frame
from tests.frames import EXAMPLES
from tests.report.test_figures import assert_readable


def test_plans_show_the_centers_with_ellipses_of_95_percent():
    result = cvxshear.identify(random_frame(2, 3).experiment(noise=0.005, std=0.005, seed=1), method="one-shot")
    figure = figures.plans(result)
    assert_readable(figure)
    for floor, axes in enumerate(figure.axes):
        centers = {line.get_label(): np.ravel(line.get_data()) for line in axes.lines}
        np.testing.assert_allclose(centers["center of mass"], result.frame.mass_center[floor])
        np.testing.assert_allclose(centers["center of stiffness"], result.frame.stiffness_center[floor])
        of_mass = next(each for each in axes.patches if isinstance(each, Ellipse))
        # Chi-square of two degrees of freedom is below 5.991 with 95 %.
        expected = 2.0 * np.sqrt(5.991) * result.frame.mass_center_std[floor]
        np.testing.assert_allclose([of_mass.width, of_mass.height], expected, rtol=1e-4)


def test_modes_from_above_name_their_shares():
    result = cvxshear.identify(
        random_frame(2, 31, symmetric=True).experiment(noise=0.001, std=0.001), method="one-shot"
    )
    figure = figures.plan_shapes(result)
    assert_readable(figure)
    titles = [axes.get_title(loc="left") or axes.get_title() for axes in figure.axes]
    assert len(titles) == 6
    assert all("100 %" in title or "9" in title for title in titles)


def test_a_page_of_an_identification(tmp_path):
    page = tmp_path / "frame.html"
    with pytest.raises(SystemExit) as stopped:
        main(["identify", str(EXAMPLES / "turning_floors.toml"), "--report", str(page), "--quiet"])
    assert stopped.value.code == 0
    text = page.read_text()
    for figure in ("plans", "plan_shapes"):
        assert f'id="figure-{figure}"' in text
    with pytest.raises(InputError, match="floors that turn"):
        figures.plans(cvxshear.identify("paper"))
