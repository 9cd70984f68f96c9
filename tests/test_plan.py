"""`leadline plan`: predictions that scale as they must, a command that explains itself, mistakes in one line.

Against the simulator's pictures: test_plan_simulation.py.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from leadline.cli import main
from leadline.config import Config
from leadline.evaluation.plan import AIMED, Rehearsal, aimed, places
from leadline.evaluation.plan_advice import ranked
from leadline.evaluation.plan_rig import Drawing, with_expected_calibration
from leadline.evaluation.plan_sight import MATCHED, Conditions, expected_points, vector_at
from leadline.evaluation.plan_view import FINE_M, hand_overs, views
from leadline.geometry import Pose
from leadline.ranging.calibration_error import position_cov
from leadline.rig import Rig
from leadline.target import Cylinder, Plane, Sphere, Surface, Target

BALL = Sphere(0.34)
DRAWN = Drawing(0.063, 1400.0, (1920, 1080), index=1.335, laser_origin_m=(-0.039, 0.088, 0.02),
                laser_direction=(-0.0609878, -0.0259948, 0.9978))  # fmt: skip
DRAWING = ["--baseline", "0.063", "--focal", "1400", "--laser=-0.039,0.088,0.02:-0.061,-0.026,0.998"]


def stereo_only(rig: Rig, target: Target = BALL, **changes: float) -> Rehearsal:
    """No floors: what remains is noise."""
    config = Config()
    config = config.model_copy(
        update={
            "status": config.status.model_copy(update={"bias_px": 0.0, "laser_bias_m": 0.0}),
            "stereo": config.stereo.model_copy(update={"roughness_m": 0.0}),
        }
    )
    return Rehearsal(rig, target, Conditions(attenuation_per_m=0.0, unlike_px_per_rad=0.0, **changes), config)


def test_a_drawing_of_the_rendered_rig_is_that_rig() -> None:
    drawn, known = DRAWN.rig(), Rig.load("rendered")
    middle = [(known.left.width - 1) / 2, (known.left.height - 1) / 2]
    shifted = dataclasses.replace(known.left, cx=middle[0], cy=middle[1])
    known = dataclasses.replace(known, left=shifted, right=shifted)
    points = np.array([[0.0, 0.0, 0.2], [0.2, 0.1, 1.0], [-0.5, 0.3, 2.2]])
    for ours, theirs in zip(drawn.project(points), known.project(points), strict=True):
        assert ours == pytest.approx(theirs, abs=1e-6)
    assert drawn.laser is not None
    assert known.laser is not None
    assert drawn.laser.direction == pytest.approx(known.laser.direction, abs=1e-6)
    assert drawn.laser.group_index == pytest.approx(known.laser.group_index, abs=2e-4)


@pytest.mark.parametrize("target", [BALL, Plane()], ids=["sphere", "plane"])
def test_stereo_scales_as_it_must(target: Target) -> None:
    """sigma = Z^2 sigma_px / (f b): with half the noise, half; with twice the baseline, half; at twice the distance of
    a view that is filled all the same, four times."""
    rig = dataclasses.replace(DRAWN.rig(), laser=None)
    T = rig.T_right_left
    wide = dataclasses.replace(rig, T_right_left=Pose(T.R, 2 * T.t_m))
    here = np.array([0.0, 0.0, 2.0 if target is BALL else 3.5])  # from there on a wall is matched in full-size pixels
    sigma = stereo_only(rig, target).cell(here).each["stereo"]
    assert stereo_only(rig, target, noise_grey=0.8).cell(here).each["stereo"] == pytest.approx(sigma / 2, rel=0.02)
    if target is BALL:  # of a wall, two cameras farther apart have less in common
        assert stereo_only(wide, target).cell(here).each["stereo"] == pytest.approx(sigma / 2, rel=0.05)
    else:
        assert stereo_only(rig, target).cell(2 * here).each["stereo"] == pytest.approx(4 * sigma, rel=0.05)


def test_patch_noise_is_the_limit_of_its_pixels() -> None:
    """Cramer and Rao: sigma^2 = 2 noise^2 / sum of squared slopes; a shrunk image's pixels are larger."""
    c = Conditions(noise_grey=2.0, texture_grey_px=4.0, attenuation_per_m=0.0)
    assert c.match_sigma_px(1.0, 0.0, 10, 0) == pytest.approx(np.sqrt(2 * 4 / (100 * 16)) / MATCHED)
    assert 4 * c.match_sigma_px(1.0, 0.0, 10, 2) == pytest.approx(c.match_sigma_px(1.0, 0.0, 10, 0))
    murky = dataclasses.replace(c, attenuation_per_m=1.0)
    assert murky.match_sigma_px(2.0, 0.0, 10, 0) == pytest.approx(c.match_sigma_px(2.0, 0.0, 10, 0) * np.exp(2))
    assert 2 * c.match_sigma_px(1.0, 0.1, 1e6, 1) == pytest.approx(0.1 * c.unlike_px_per_rad)


def test_patches_that_overlap_do_not_count_twice() -> None:
    """Ten times as many patches on the same pixels say hardly more."""
    rig, x = DRAWN.rig(), vector_at(Plane(), np.array([0.0, 0.0, 2.0]))
    settings = Config().stereo
    information = []
    for patches in (settings.patches, 10 * settings.patches, 100 * settings.patches):
        points = expected_points(rig, Plane(), settings.model_copy(update={"patches": patches}), Conditions(), x)
        assert points is not None
        information.append(float((1 / points.sigma_m**2).sum()) / points.shared)
    assert information[2] < 1.5 * information[1]


def test_floors_are_not_averaged_away() -> None:
    rehearsal = Rehearsal(dataclasses.replace(DRAWN.rig(), laser=None), BALL, Conditions(frames_hz=100.0))
    floor = 2.0**2 * Config().status.bias_px / (1400 * 1.335 * 0.063)
    filtered = rehearsal.cell(np.array([0.0, 0.0, 2.0])).filtered_m
    assert filtered is not None
    assert filtered > floor


def test_filtering_and_the_laser_help_where_noise_rules() -> None:
    rehearsal = Rehearsal(DRAWN.rig(), BALL, Conditions(texture_grey_px=1.0))
    cell = rehearsal.cell(aimed(rehearsal.rig, 4.0))
    bare = rehearsal.without_laser().cell(aimed(rehearsal.rig, 4.0))
    assert cell.filtered_m is not None
    assert cell.alone_m is not None
    assert bare.filtered_m is not None
    assert cell.filtered_m < cell.alone_m
    assert cell.filtered_m < 0.7 * bare.filtered_m
    assert (cell.stage, bare.stage) == (2, 1)


def test_an_expected_calibration_is_that_of_thousand_simulated_ones() -> None:
    """25 + 25 board pairs at 0.05 px: 0.22 mm of the port's distance and 1.7e-4 of the index were measured so."""
    rig = with_expected_calibration(DRAWN.rig(), 25)
    sigma = {n: float(np.sqrt(rig.covariance.of((n,))[0, 0])) for n in ("port.distance_m", "water.index")}
    assert sigma["port.distance_m"] == pytest.approx(0.22e-3, rel=0.25)
    assert sigma["water.index"] == pytest.approx(1.7e-4, rel=0.25)
    here = np.array([0.0, 0.0, 2.2])
    few, many = (position_cov(with_expected_calibration(DRAWN.rig(), n), here)[2, 2] for n in (20, 60))
    assert 1.4 < np.sqrt(few / many) < 2.2  # the root of three, and where the boards happen to lie
    assert not with_expected_calibration(rig, 0).covariance.names


@pytest.mark.parametrize("target", [BALL, Sphere(), Plane(), Cylinder(0.5), Surface()], ids=lambda t: t.name)
def test_every_shape_has_a_plan(target: Target) -> None:
    rehearsal = Rehearsal(DRAWN.rig(), target, Conditions())
    for place, nearest in places(rehearsal.rig, 1.0).items():
        cell = rehearsal.cell(nearest, place)
        assert "stereo" in cell.each
        assert cell.filtered is not None
        assert cell.filtered.position_m >= 0.9 * cell.filtered.range_m


def test_hand_overs_are_where_the_geometry_puts_them() -> None:
    rig = DRAWN.rig()
    assert rig.laser is not None
    # Straight ahead, the ball of 0.34 m is 0.95 times as high as the picture where half its angle is that of 513 px.
    sine = np.sin(np.arctan(0.95 * 540 / (1400 * 1.335)))
    ahead = hand_overs(Rehearsal(dataclasses.replace(rig, laser=None), BALL, Conditions()))
    assert ahead.fills_until_m == pytest.approx(0.17 / sine - 0.17, rel=0.07)
    assert ahead.spot_left_m is None
    found = hand_overs(Rehearsal(rig, BALL, Conditions()))
    assert found.spot_left_m is not None
    step = FINE_M[1] / FINE_M[0]
    lengths = np.array([found.spot_left_m[0] / step, found.spot_left_m[0]])
    v = rig.project(rig.laser.origin_m + lengths[:, None] * rig.laser.direction)[0][:, 1]
    assert v[1] <= rig.left.height - 1 < v[0]
    assert found.spans_m["size"][0] > found.spans_m["stereo"][0]
    near, far = views(rig, (0.2, 2.2))
    assert near.disparity_px == pytest.approx(600, rel=0.02)
    assert near.overlap < far.overlap
    assert near.spot_left_px is None


def test_advice_is_ranked_and_in_words() -> None:
    rehearsal = Rehearsal(DRAWN.rig(), BALL, Conditions())
    gains = ranked(rehearsal, 2.2)
    assert [g.after_m for g in gains] == sorted(g.after_m for g in gains)
    assert len({g.before_m for g in gains}) == 1
    baseline = next(gain for gain in gains if "baseline" in gain.change)
    assert baseline.after_m < 0.9 * baseline.before_m
    assert str(baseline).startswith("a baseline of 126 mm would bring ")
    assert str(baseline).endswith(" mm at 2.2 m")


def test_the_command_prints_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "rendered", "--out", str(tmp_path / "plan")]) == 0
    printed = capsys.readouterr().out
    assert "sigma of the range, mm" in printed
    assert "the laser's spot: from" in printed
    assert "would bring" in printed
    assert "assumed: calibration: the rig states none" in printed
    page = (tmp_path / "plan" / "plan.html").read_text()
    assert page.count("<svg") == 3
    assert "$" not in page
    assert (tmp_path / "plan" / "plan.svg").read_text().startswith("<svg")
    numbers = json.loads((tmp_path / "plan" / "plan.json").read_text())
    assert {cell["place"] for cell in numbers["cells"]} == {AIMED, "centre", "half field", "corner"}


def test_a_drawing_without_laser_in_air_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    drawing = ["--baseline", "0.12", "--focal", "900", "--size", "1280x720", "--port", "0"]
    assert main(["plan", *drawing, "--target", "plane", "--json", "--boards", "0"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["without_laser"] == []
    assert all(set(cell["each"]) <= {"stereo"} for cell in numbers["cells"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "give a rig or draw one"),
        (["rendered", *DRAWING], "give a rig or draw one"),
        (["none.yaml"], "none.yaml"),
        (["--baseline", "0.1"], "--baseline and --focal go together"),
        (["--index", "1.34"], "give a rig or draw one"),
        (["--baseline", "-1", "--focal", "1400"], "--baseline: -1 is not from 0.005 to 9 m"),
        (["--baseline", "0.063", "--focal", "1400", "--size", "big"], "is not a size"),
        (["--baseline", "0.063", "--focal", "1400", "--laser", "1,2"], "is not three numbers"),
        (["--baseline", "0.063", "--focal", "1400", "--index", "0.9"], "--index: 0.9 is not from 1.3"),
        (["--baseline", "0.063", "--focal", "1400", "--laser", "0,0,0:0,0,0"], "does not go ahead"),
        (["rendered", "--target", "cube"], "is not a target"),
        (["rendered", "--noise", "-1"], "--noise: -1 is not from 0.01"),
        (["rendered", "--attenuation", "inf"], "--attenuation: inf is not from 0 to 10 1/m"),
        (["rendered", "--texture", "inf"], "--texture: inf"),
        (["rendered", "--at", "nan"], "--at: nan"),
        (["rendered", "--boards", "-1"], "--boards"),
        (["--baseline", "3", "--focal", "1400"], "--boards 0"),
    ],
)
def test_a_mistake_is_one_line(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", *arguments]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    "option",
    [
        "--index=1.34",
        "--index=nan",
        "--port=nan",
        "--glass=0.002",
        "--size=640x360",
        "--laser=0,0,0",
        "--laser-sigma=-1",
    ],
)
def test_a_rig_is_not_redrawn(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Planned as if nothing had been said before."""
    assert main(["plan", "rendered", option]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith(
        f"leadline: {option.partition('=')[0]}: give a rig or draw one, not both; leave that out"
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--port=-0.01"], "--port: -0.01 is not from 0 to 1 m (0: in air)"),
        (["--port=nan"], "--port: nan"),
        (["--port=0", "--index=1.34"], "--index: a rig in air (--port 0) has none; leave it out"),
        (["--port=0", "--glass=0.002"], "--glass: a rig in air"),
        (["--glass=-1"], "--glass: -1 is not from 0 to 0.1 m"),
        (["--glass=5"], "--glass: 5"),
        (["--index=133"], "--index: 133 is not from 1.3 to 1.5 (water: 1.33 to 1.35)"),
        (["--focal=1"], "--focal: 1 px is no lens before images 1920 px wide; give 384 to 38400"),
        (["--focal=nan"], "--focal: nan"),
        (["--size=1x1"], "--size: '1x1' is not a size"),
        (["--laser=0,0.1,0:0,0,-1"], "--laser: a beam along 0,0,-1 does not go ahead"),
        (["--laser=nan,0,0"], "--laser: 'nan,0,0' is not three numbers"),
        (["--laser-sigma=0.01"], "--laser-sigma: there is no laser"),
        (["--laser=0,0.1,0", "--laser-sigma=nan"], "--laser-sigma: nan"),
    ],
)
def test_a_rig_that_nobody_can_build_is_not_planned(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", "--baseline", "0.1", "--focal", "1400", *options]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert said in told.err
    assert told.err.count("\n") == 1


def test_a_plan_without_any_number_is_none(capsys: pytest.CaptureFixture[str]) -> None:
    hopeless = ["--target", "plane", "--noise", "100", "--texture", "0.01", "--boards", "0"]
    assert main(["plan", "--baseline", "0.1", "--focal", "38400", *hopeless]) == 2
    assert "nothing can be measured of the target from 0.2 to 5 m" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_what_the_rig_cannot_see_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    """Distances within a deep port, a ball that reaches behind the cameras: no NaN, no warning."""
    assert main(["plan", "--baseline", "0.1", "--focal", "500", "--port", "0.5", "--boards", "0"]) == 0
    assert "nan" not in capsys.readouterr().out
