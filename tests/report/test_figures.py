"""Test figures for two to twenty stories: no overlap, no clipping, and values equal to the result."""

import itertools
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

import cvxshear
from cvxshear import close_loop
from cvxshear.report import figures, html
from cvxshear.report.figures import style
from cvxshear.report.figures.mode_figures import mac_tables, mode_shapes
from cvxshear.report.figures.style import inline_svg, letters, spread
from cvxshear.util.errors import InputError
from tests import frames
from tests.loop.test_open_classes import measured_in

OF_A_LOOP = [figures.findings, figures.frame, figures.shapes, figures.mac]


def boxes(figure):
    """Return every visible text with its box from the renderer, pixels."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    texts = [*figure.texts, *(text for legend in figure.legends for text in legend.get_texts())]
    for axes in figure.axes:
        texts += [each for each in axes.get_children() if isinstance(each, Text)]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [tick for tick in axis.get_major_ticks() if low - 1e-9 <= tick.get_loc() <= high + 1e-9]
            texts += [axis.label, *(label for tick in ticks for label in (tick.label1, tick.label2))]
    return [
        (text.get_text(), text.get_window_extent(renderer))
        for text in texts
        if text.get_visible() and text.get_text().strip()
    ]


def assert_readable(figure):
    assert isinstance(figure, Figure)
    found = boxes(figure)
    assert found
    width, height = figure.bbox.size
    for text, box in found:
        assert "mathdefault" not in text
        inside = box.x0 >= -1 and box.y0 >= -1 and box.x1 <= width + 1 and box.y1 <= height + 1
        assert inside, f"{text!r} is cut off"
    for (text, a), (other, b) in itertools.combinations(found, 2):
        # Half a pixel of side bearings is not an overlap.
        shared = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        assert min(shared) < 1.0, f"{text!r} and {other!r} overlap by {shared} pixels"


@pytest.mark.parametrize("draw", OF_A_LOOP, ids=lambda draw: draw.__name__)
@pytest.mark.parametrize("result", ["paper", "twenty", "unexplained", "nine"])
def test_no_text_of_a_loops_figure_overlaps_or_is_cut_off(draw, result, request):
    assert_readable(draw(request.getfixturevalue(result)))


def test_no_text_of_the_other_figures_overlaps_or_is_cut_off(paper, study, six_story, no_heights):
    two_stage = cvxshear.identify(paper.experiment, method="two-stage")
    for figure in (figures.frame(two_stage), figures.frame(no_heights), figures.mac(two_stage)):
        assert_readable(figure)
    for result in (study, six_story):
        assert_readable(figures.noise_boxes(result))
        assert_readable(figures.noise_variation(result))


def test_the_residual_is_in_the_noise_of_the_final_model(paper):
    parts = paper.to_dict()["residual"]["by_part"]
    found = {
        side: np.array([each["deviations"] for each in parts[side] if each["noise"] == "frequency"]) for side in parts
    }
    measured = np.concatenate([each.frequencies for each in paper.experiment.configurations])
    # No noise is declared. The default is 0.2 %, and the final model estimates its factor.
    noise = 0.002 * paper.noise.to_dict()["frequency"]["factor"]
    logs = {
        side: np.log(np.concatenate([each.frequencies for each in step.estimate.predictions]) / measured)
        for side, step in (("before", paper.before), ("after", paper.after))
    }
    # The fit uses the noise estimated by the previous fit. The two agree within a few percent.
    assert found["before"] == pytest.approx(logs["before"] / noise, rel=0.05)
    ratio = found["before"] / logs["before"]
    assert ratio == pytest.approx(ratio[0])
    assert found["after"] == pytest.approx(logs["after"] * ratio[0])


def test_the_caption_of_the_mac_says_where_sensors_are_few():
    tested = frames.configuration([10.0] * 4, [24e3] * 4, measured_floors=[2, 4], modes=[1, 2, 3])
    few = cvxshear.identify(frames.experiment([10.0] * 4, [24e3] * 4, tested))
    whole = cvxshear.identify(frames.experiment([10.0] * 4, [24e3] * 4))
    caption = figures.figures_of(cvxshear.Identification)["mac"].caption_of
    assert "At 2 of 4 floors different modes look alike" in caption(few)
    assert "look alike" not in caption(whole)


def test_shapes_are_scaled_to_the_measured_ones(eight):
    for item, target in zip(
        mode_shapes(eight.estimate),
        [(each, j) for each in eight.experiment.configurations for j in range(len(each.frequencies))],
        strict=True,
    ):
        configuration, j = target
        measured = configuration.mode_shapes[j]
        assert np.nanmax(np.abs(item.measured)) == pytest.approx(1.0)
        largest = int(np.argmax(np.abs(measured)))
        assert item.measured * (measured[largest] / item.measured[largest]) == pytest.approx(measured)
        # After least squares, the residual is orthogonal to the model's shape.
        assert (item.measured - item.modelled) @ item.modelled == pytest.approx(0.0, abs=1e-9)


def test_the_mac_matrix_is_that_of_the_predictions(paper):
    for (name, table), prediction, configuration in zip(
        mac_tables(paper), paper.estimate.predictions, paper.experiment.configurations, strict=True
    ):
        assert name == configuration.name
        for i, a in enumerate(configuration.mode_shapes):
            for j, b in enumerate(prediction.mode_shapes):
                assert table[i, j] == pytest.approx(np.dot(a, b) ** 2 / np.dot(a, a) / np.dot(b, b))
    assert min(np.diag(table).min() for _, table in mac_tables(paper)) == pytest.approx(
        paper.after.estimate.quality.min_mac
    )


def test_variation_has_the_bound_beside_it(study):
    axes = figures.noise_variation(study).axes[2]
    drawn = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert drawn["two-stage"] == pytest.approx(
        [100 * each.variation[2] for each in study.scatters if each.method == "two-stage"]
    )
    assert drawn["Cramér-Rao bound"][-1] == pytest.approx(1.79, abs=0.005)


@pytest.mark.parametrize(("kind", "start"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF")])
def test_a_figure_is_written_whole_and_the_same_each_time(paper, tmp_path, kind, start):
    out = tmp_path / f"frame.{kind}"
    figures.save(figures.frame(paper), out)
    first = out.read_bytes()
    figures.save(figures.frame(paper), out)
    assert first.startswith(start)
    assert out.read_bytes() == first
    assert list(tmp_path.iterdir()) == [out]


def test_another_ending_is_refused_and_nothing_written(paper, tmp_path):
    with pytest.raises(InputError, match=r"frame\.jpg: a figure is written as \.svg, \.png or \.pdf"):
        figures.save(figures.frame(paper), tmp_path / "frame.jpg")
    with pytest.raises(InputError, match="cannot be written"):
        figures.save(figures.frame(paper), tmp_path / "nowhere" / "frame.svg")
    assert list(tmp_path.iterdir()) == []


def test_no_setting_of_the_user_is_changed_and_no_window_opened():
    code = (
        "import matplotlib as mpl\n"
        "mpl.rcParams['font.size'] = 17\n"
        "before = {key: mpl.rcParams[key] for key in mpl.rcParams if key != 'backend'}\n"
        "import cvxshear, sys\n"
        "from cvxshear.report import figures\n"
        "figures.frame(cvxshear.identify(cvxshear.load('paper')))\n"
        "print('matplotlib.pyplot' in sys.modules)\n"
        "print({key: mpl.rcParams[key] for key in before} == before)\n"
    )
    shown = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["False", "True"]


def test_a_user_setting_does_not_change_a_figure(paper):
    plain = inline_svg(figures.frame(paper), "a")
    with mpl.rc_context({"font.size": 30, "axes.facecolor": "red"}):
        assert inline_svg(figures.frame(paper), "a") == plain


def test_names_are_shown_on_one_line_in_letters_that_there_are():
    assert letters("a\nb  c") == "a b c"
    assert letters("x" * 40, 10) == "x" * 9 + "…"
    assert letters("\U0010ffff") == "□"


def test_labels_are_spread_and_stay_between_the_ends():
    placed = spread(np.array([0.0, 0.1, 0.2, 5.0]), 1.0, 0.0, 5.0)
    assert np.diff(placed).min() >= 1.0 - 1e-12
    assert placed == pytest.approx([0.0, 1.0, 2.0, 5.0])
    assert spread(np.array([4.8, 4.9, 5.0]), 1.0, 0.0, 5.0) == pytest.approx([3.0, 4.0, 5.0])


def test_what_was_found_is_marked_at_its_place_with_its_probability(nine):
    """One of nine states has an undeclared mass: only this state's drawing marks its floor."""
    (effect,) = nine.effects
    floor, state = effect.placed.place.floor, effect.placed.place.state
    drawn = figures.findings(nine)
    assert len(drawn.axes) == 2
    z = nine.experiment.frame.elevations
    for axes in drawn.axes:
        marked = [patch for patch in axes.patches if mpl.colors.to_hex(patch.get_edgecolor()) == "#d55e00"]
        said = " ".join(text.get_text().replace("\n", " ") for text in axes.texts)
        if state in axes.get_title(loc="left"):
            (mark,) = marked
            assert mark.get_y() < z[floor - 1] < mark.get_y() + mark.get_height()
            assert f"{100 * effect.probability:.1f} % probable" in said or "> 99.9 % probable" in said
        else:
            assert marked == []
            assert "nothing was found here" in said


def test_a_figure_shows_itself(paper):
    figure = paper.figure("mac")
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert paper.figure().axes[0].get_title(loc="left") == "every state"
    with pytest.raises(InputError, match="there is no figure 'pie' here; there are findings, frame"):
        paper.figure("pie")


def test_figures_drawn_in_threads_are_those_drawn_alone(paper, eight):
    """The user also draws in the meantime; all settings stay."""
    settings = {key: value for key, value in mpl.rcParams.items() if key != "backend"}
    wanted = {result: inline_svg(figures.mac(result), "a") for result in (paper, eight)}

    def drawn(place):
        result = (paper, eight)[place % 2]
        return inline_svg(figures.mac(result), "a") == wanted[result]

    with ThreadPoolExecutor(6) as pool:
        assert all(pool.map(drawn, range(12)))
    assert {key: value for key, value in mpl.rcParams.items() if key != "backend"} == settings


def test_a_figure_from_outside_is_found_everywhere(paper, comparison, monkeypatch, tmp_path, printed):
    # Keep three of the package's figures for each kind of result.
    few = {key: dict(list(value.items())[:3]) for key, value in style.FIGURE_TABLE.items()}
    monkeypatch.setattr(style, "FIGURE_TABLE", few)

    @figures.figure(
        "pie", cvxshear.LoopResult, title="Where the mass is", applies=lambda result: len(result.frame.floor_mass) > 1,
        needs="two floors",
    )  # fmt: skip
    def pie(result):
        """A pie of masses.

        Each floor's share of the mass.
        """
        drawn = Figure(figsize=(2, 2))
        drawn.subplots().pie(result.frame.floor_mass)
        return drawn

    assert paper.figure("pie").get_figwidth() == 2
    page = html.render(paper, "cvxshear", comparison)
    assert 'id="figure-pie"' in page
    for words in ("Where the mass is", "Each floor&#39;s share of the mass.", "A pie of masses."):
        assert words in page
    said = printed("loop", "paper", "--figure", "list")
    for entry in figures.figures_of(cvxshear.LoopResult).values():
        assert any(line.split()[:1] == [entry.name] and entry.title in line for line in said.splitlines())
    printed("loop", "paper", "--effects", "gravity", "--figure", f"pie:{tmp_path / 'pie.svg'}")
    assert (tmp_path / "pie.svg").read_text().startswith("<?xml")


def test_where_the_shear_model_fails_is_drawn_and_told():
    """An unmodeled brace (6000 kN/m) connects floors 1 and 4 of a five-story chain."""
    rng, mass, k = np.random.default_rng(4), np.full(5, 1e4), np.linspace(2.4e7, 1.6e7, 5)
    across = np.array([-1.0, 0.0, 0.0, 1.0, 0.0])
    K = frames.chain(mass, k)[1] + 6e6 * np.outer(across, across)
    loads = {"bare": 0.0 * across, "loaded": np.array([0.0, 0.0, 0.0, 0.0, 3e3])}
    tests = [measured_in(mass, k, rng, name=name, state="bare", added=load, K=K) for name, load in loads.items()]
    declared = {"frame": {"story_heights": 3.0, "total_mass": 5e4}, "configuration": tests}
    found = close_loop(cvxshear.Experiment.from_dict(declared), ["other_stiffness", "gravity", "base_rocking"])
    assert found.verdict == "located"
    assert "floors 1 and 4" in str(found).replace("\n", " ")
    axes = found.figure("findings").axes[0]
    ties = [line for line in axes.lines if mpl.colors.to_hex(line.get_color()) == "#d55e00"]
    assert [list(line.get_ydata()) for line in ties] == [[3.0, 12.0]]
    (effect,) = found.effects
    value, std = effect.parameters["floors 1 and 4"], effect.std["floors 1 and 4"]
    assert abs(value - 6e6) < 3 * std
