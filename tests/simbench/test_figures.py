import re
import subprocess
import sys
from dataclasses import replace

import matplotlib
import matplotlib.image
import numpy as np
import pytest
from scipy import stats

from simbench.errors import InputError, OutputError
from simbench.figures import (
    consistency,
    decay,
    errors,
    nees,
    save,
    spread,
    svg,
    trajectories,
    within_bands,
)
from tests.simbench.records import circle, without


def lines(ax):
    """The labelled lines of an axes."""
    return {line.get_label(): line for line in ax.lines if not line.get_label().startswith("_")}


def edges(ax):
    """Lower and upper edge of the band, as drawn."""
    low, high = (line.get_ydata() for line in ax.lines if line.get_linestyle() == "--")
    return np.asarray(low), np.asarray(high)


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_trajectories_hold_the_paths_and_the_maps_of_the_record():
    planted = circle(landmarks=30)
    record = planted.record
    (ax,) = trajectories([record]).axes
    drawn = {name: line.get_xydata() for name, line in lines(ax).items()}
    truth = record.dataset.truth
    np.testing.assert_array_equal(drawn["estimated path"], record.T_world_imu[:, :2, 3])
    np.testing.assert_array_equal(drawn["true path"], truth.T_world_imu[:, :2, 3])
    np.testing.assert_array_equal(drawn["true landmark"], truth.landmarks[:, :2])
    np.testing.assert_array_equal(drawn["estimated landmark"], record.final.landmarks[:, :2])
    np.testing.assert_array_equal(drawn["start"], record.T_world_imu[[0], :2, 3])
    np.testing.assert_array_equal(drawn["end"], record.T_world_imu[[-1], :2, 3])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "y [m]")
    assert ax.get_aspect() == 1


def test_trajectories_of_three_runs_stand_side_by_side_and_show_the_same_part_of_the_world():
    record = circle().record
    figure = trajectories([replace(record, filter=name) for name in ("a", "b", "c")])
    figure.draw_without_rendering()
    boxes = [ax.get_position() for ax in figure.axes]
    assert boxes[0].x1 < boxes[1].x0 < boxes[1].x1 < boxes[2].x0
    assert boxes[0].y0 == pytest.approx(boxes[2].y0)
    assert len({(ax.get_xlim(), ax.get_ylim()) for ax in figure.axes}) == 1
    assert [ax.get_title().split(",")[0] for ax in figure.axes] == ["a", "b", "c"]


@pytest.mark.parametrize("runs", [1, 2, 4, 5])
def test_every_column_of_trajectories_has_its_axis_label(runs):
    figure = trajectories([circle().record] * runs)
    assert len(figure.axes) == runs
    assert sum(ax.get_xlabel() == "x [m]" for ax in figure.axes) == min(runs, 3)


@pytest.mark.parametrize("runs", [1, 2, 3, 4])
@pytest.mark.parametrize("stretch", [0.2, 1, 5])
def test_nothing_of_trajectories_lies_beyond_the_edge(runs, stretch):
    record = circle().record
    for T in (
        record.dataset.truth.T_world_imu,
        *(step.belief.T_world_imu for step in record.steps),
    ):
        T[..., 1, 3] *= stretch
    record.dataset.truth.landmarks[:, 1] *= stretch
    figure = trajectories([record] * runs)
    figure.draw_without_rendering()
    for ax in figure.axes:
        box = ax.get_tightbbox().transformed(figure.transFigure.inverted())
        assert -0.01 < box.x0 < box.x1 < 1.01
        assert -0.01 < box.y0 < box.y1 < 1.01


def test_the_title_of_a_trajectory_tells_its_error():
    record = circle().record
    distance = record.T_world_imu[:, :3, 3] - record.dataset.truth.T_world_imu[:, :3, 3]
    rmse = np.sqrt(np.mean(np.sum(distance**2, axis=1)))
    assert trajectories([record]).axes[0].get_title() == f"slam, ATE {rmse:.3g} m"


def test_without_truth_trajectories_hold_the_estimate_alone():
    figure = trajectories([without(circle(), truth=True)])
    assert set(legend(figure)) == {"estimated path", "estimated landmark", "start", "end"}
    assert figure.axes[0].get_title() == "slam"


def test_a_far_landmark_does_not_shrink_the_path():
    planted = circle(landmarks=200)
    planted.record.final.landmarks[0] = [1e4, -1e4, 0]
    (ax,) = trajectories([planted.record]).axes
    assert np.ptp(ax.get_xlim()) < 60
    assert np.ptp(ax.get_ylim()) < 60


def test_thousands_of_landmarks_are_pixels_in_a_vector_file(tmp_path):
    figure = trajectories([circle(frames=5, landmarks=10_000).record])
    for name, line in lines(figure.axes[0]).items():
        assert bool(line.get_rasterized()) == (name in {"true landmark", "estimated landmark"})
    save(figure, tmp_path / "big.pdf")
    assert (tmp_path / "big.pdf").stat().st_size < 400_000


def test_no_run_is_no_figure():
    with pytest.raises(InputError, match="at least one run"):
        trajectories([])


def test_errors_hold_the_planted_errors_and_three_sigma():
    planted = circle()
    figure = errors(planted.record)
    seconds = planted.record.dataset.times_s - 100
    scale = [1, 1, 1, *[180 / np.pi] * 3]
    by_axis = [figure.axes[i] for i in (0, 2, 4, 1, 3, 5)]  # left column, then right
    for k, ax in enumerate(by_axis):
        line = lines(ax)["error"]
        np.testing.assert_allclose(line.get_xdata(), seconds)
        np.testing.assert_allclose(line.get_ydata(), scale[k] * planted.pose_error[:, k], atol=1e-9)
        low, high = edges(ax)
        sigma = scale[k] * np.sqrt(planted.pose_covariance[:, k, k])
        np.testing.assert_allclose(high, 3 * sigma)
        np.testing.assert_allclose(low, -3 * sigma)
    assert [ax.get_ylabel() for ax in by_axis] == [
        *(rf"$\rho_{c}$ [m]" for c in "xyz"),
        *(rf"$\phi_{c}$ [deg]" for c in "xyz"),
    ]
    assert [ax.get_xlabel() for ax in figure.axes[-2:]] == ["time [s]"] * 2


def test_consistency_holds_nees_and_nis_with_their_bands():
    planted = circle()
    top, bottom = consistency(planted.record).axes
    assert (top.get_ylabel(), bottom.get_ylabel()) == ("pose NEES / 6 [-]", "NIS / dof [-]")
    assert bottom.get_xlabel() == "time [s]"
    expected = [
        e @ np.linalg.solve(P, e) / 6
        for e, P in zip(planted.pose_error[1:], planted.pose_covariance[1:], strict=True)
    ]
    drawn = lines(top)["slam"].get_ydata()
    assert np.isnan(drawn[0])  # the start is known exactly
    np.testing.assert_allclose(drawn[1:], expected, rtol=1e-7)
    np.testing.assert_allclose(edges(top)[0], stats.chi2.ppf(0.025, 6) / 6)
    np.testing.assert_allclose(edges(top)[1], stats.chi2.ppf(0.975, 6) / 6)

    innovations = [step.innovation for step in planted.record.steps[1:]]
    dof = np.array([4 * i.accepted.sum() for i in innovations])
    nis = np.array([np.sum(i.whitened**2) for i in innovations])
    np.testing.assert_allclose(lines(bottom)["slam"].get_ydata()[1:], nis / dof)
    low, high = edges(bottom)
    assert np.isnan([low[0], high[0]]).all()
    np.testing.assert_allclose(low[1:], stats.chi2.ppf(0.025, dof) / dof)
    np.testing.assert_allclose(high[1:], stats.chi2.ppf(0.975, dof) / dof)


def test_the_scale_is_logarithmic_only_where_values_leave_the_band_far_behind():
    planted = circle()
    assert [ax.get_yscale() for ax in consistency(planted.record).axes] == ["linear", "linear"]
    for step in planted.record.steps[30:]:
        step.belief.pose_covariance[:] /= 100
    assert [ax.get_yscale() for ax in consistency(planted.record).axes] == ["log", "linear"]


def test_an_infinite_nees_is_said():
    planted = circle(frames=20)
    for step in planted.record.steps[3:7]:
        step.belief.pose_covariance[0, 0] = -1
    (text,) = consistency(planted.record).axes[0].texts
    assert text.get_text() == "infinite in 4 of 20 frames"
    errors(planted.record).draw_without_rendering()


def texts(figure):
    return [[text.get_text() for text in ax.texts] for ax in figure.axes]


def test_a_panel_without_values_says_why():
    planted = circle()
    bare = without(planted, truth=True, covariance=True, innovations=True)
    assert texts(consistency(bare)) == [["no truth"], ["no innovations"]]
    assert texts(consistency(without(planted, covariance=True))) == [["no pose covariance"], []]
    assert texts(errors(bare)) == [["no truth, no covariance"]] * 6
    assert legend(errors(without(planted, truth=True))) == [r"$\pm 3\sigma$, no truth"]
    assert legend(errors(without(planted, covariance=True))) == ["error, no covariance"]


@pytest.mark.parametrize("draw", [errors, consistency, lambda record: trajectories([record])])
@pytest.mark.parametrize(("frames", "landmarks"), [(1, 0), (2, 20), (30, 0)])
@pytest.mark.parametrize("lacking", [(), ("truth",), ("covariance", "innovations")])
def test_every_figure_can_be_drawn_whatever_a_run_lacks(draw, frames, landmarks, lacking):
    record = without(circle(frames, landmarks), **dict.fromkeys(lacking, True))
    draw(record).draw_without_rendering()


def test_lines_are_told_apart_without_colour():
    for figure in (trajectories([circle().record]), consistency(circle().record)):
        for ax in figure.axes:
            styles = [(line.get_linestyle(), line.get_marker()) for line in lines(ax).values()]
            assert len(set(styles)) == len(styles)


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_equal_figures_give_equal_bytes_whatever_the_user_has_set(tmp_path, suffix):
    save(consistency(circle(frames=5).record), tmp_path / f"a{suffix}")
    with matplotlib.rc_context({"font.size": 20, "axes.facecolor": "red"}):
        save(consistency(circle(frames=5).record), tmp_path / f"b{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [suffix, suffix]


def test_a_saved_picture_has_200_dots_an_inch(tmp_path):
    figure = errors(circle(frames=5).record)
    save(figure, tmp_path / "new" / "errors.png")
    height, width, _ = matplotlib.image.imread(tmp_path / "new" / "errors.png").shape
    np.testing.assert_allclose([width, height], 200 * figure.get_size_inches(), atol=1)


def test_an_unknown_kind_of_file_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r"errors\.bmp: expected a name that ends in \.png"):
        save(errors(circle(frames=5).record), tmp_path / "errors.bmp")
    assert list(tmp_path.iterdir()) == []


def test_figures_leave_pyplot_and_the_backend_alone():
    code = "import sys, simbench.figures; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_name_is_text_and_no_mathematics(tmp_path):
    record = replace(circle(frames=5).record, filter="a$b$\\frac{\n")
    for figure in (trajectories([record]), consistency(record)):
        save(figure, tmp_path / "a.png")
    assert "a$b$" in svg(trajectories([record]), "p-")


def test_a_figure_of_a_page_has_the_pages_colours_and_ids_of_its_own():
    figure = consistency(circle(frames=5).record)
    text, again = svg(figure, "a-"), svg(consistency(circle(frames=5).record), "a-")
    assert text == again
    assert not re.search(r"#[0-9a-f]{6}|http|<\?xml|<metadata", text)
    assert {"var(--blue)", "var(--shade)", "var(--grey)"} <= set(re.findall(r"var\(--\w+\)", text))
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert all(name.startswith("a-") for name in ids)
    used = re.findall(r'(?:url\(#|xlink:href="#)([^")]*)', text)
    assert used
    assert set(used) <= set(ids)


def test_nees_side_by_side_is_the_mean_over_runs_within_the_band_of_their_number():
    planted = [circle(frames=20, seed=k) for k in range(8)]
    figure = nees({"a": [p.record for p in planted], "b": [planted[0].record]})
    assert [ax.get_title() for ax in figure.axes] == ["a", "b"]
    values = [
        [
            e @ np.linalg.solve(P, e)
            for e, P in zip(p.pose_error[1:], p.pose_covariance[1:], strict=True)
        ]
        for p in planted
    ]
    drawn = lines(figure.axes[0])["mean of 8 runs"].get_ydata()
    np.testing.assert_allclose(drawn[1:], np.mean(values, axis=0) / 6, rtol=1e-7)
    low, high = edges(figure.axes[0])
    np.testing.assert_allclose([low[3], high[3]], stats.chi2.ppf([0.025, 0.975], 48) / 48)


def test_statistics_stand_where_they_lie_in_their_bands():
    figure = within_bands({"in": (1.0, 1.5, 2.0), "out": (1.0, 2.5, 2.0), "far": (0.0, 99.0, 1.0)})
    (ax,) = figure.axes
    marks = [line for line in ax.lines if line.get_marker() != "None"]
    assert [line.get_xdata()[0] for line in marks] == [0.5, 1.5, 2.0]
    assert [line.get_marker() for line in marks] == ["o", "x", ">"]


def test_deviations_are_drawn_in_size_and_zeros_left_out():
    figure = decay({"block": {1e-3: -2.0, 1e-4: 1.0}, "nis": {1e-3: 0.0, 1e-4: 0.0}})
    drawn = lines(figure.axes[0])
    assert set(drawn) == {"block", "eps squared"}
    np.testing.assert_array_equal(drawn["block"].get_xydata(), [[1e-4, 1.0], [1e-3, 2.0]])


def test_a_spread_shows_every_run_and_its_median():
    values = {"a": np.array([1.0, 2.0, 4.0]), "b": np.array([100.0])}
    (ax,) = spread(values, "error [m]").axes
    dots = [line for line in ax.lines if line.get_marker() == "o"]
    np.testing.assert_array_equal(dots[0].get_xdata(), values["a"])
    assert [label.get_text() for label in ax.get_yticklabels()] == ["a", "b"]
    assert ax.get_xscale() == "log"
    medians = [line.get_xdata()[0] for line in ax.lines if line.get_linewidth() == 1.4]
    assert medians == [2.0, 100.0]
