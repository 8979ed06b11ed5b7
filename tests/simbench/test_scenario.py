import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench import scenario
from simbench.errors import ScenarioError
from simbench.scenario import Scenario, load, loads, schema
from simbench.scenario.landmarks import LandmarkKind
from simbench.scenario.trajectories import TrajectoryKind

SCENES = sorted((Path(__file__).parents[2] / "scenarios").glob("*.yaml"))
WAYPOINTS = "points: [[0, 0, 0], [4, 0, 0], [4, 3, 1]]"


def faults(text, *overrides):
    with pytest.raises(ScenarioError) as caught:
        loads(text, where="scene.yaml", overrides=overrides)
    return [str(fault) for fault in caught.value.faults]


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_scene_of_the_repository_loads_and_says_what_it_is_for(path):
    scene = load(path)
    assert scene.name == path.stem
    assert scene.about
    assert path.read_text().startswith("# ")
    assert loads(scene.to_yaml()) == scene


@pytest.mark.parametrize(
    "path",
    [path for path in SCENES if not path.stem.startswith("drive")],
    ids=lambda path: path.stem,
)
def test_depths_stay_where_a_new_landmark_is_near_gaussian(path):
    scene = load(path)
    rig, sigma_px = scene.rig, np.max(scene.camera.sigma_px)
    assert rig.depth_m[1] < 0.05 * rig.fx_px * rig.baseline_m / (np.sqrt(2) * sigma_px)


def test_an_empty_file_is_a_scene_named_after_itself(tmp_path):
    (tmp_path / "my scene.yaml").touch()
    scene = load(tmp_path / "my scene.yaml")
    assert scene.name == "my_scene"
    assert scene.model_copy(update={"name": "scene"}) == Scenario() == loads("# nothing\n")


def test_the_shape_in_the_documentation_is_understood():
    scene = loads(
        """
        name: figure8
        about: One sentence on what the scene is for.
        seed: 7
        duration_s: 40.0
        rate_hz: 10.0
        time_jitter: 0.0
        trajectory:
          kind: figure8
          size_m: [20.0, 10.0]
          laps: 2
          roll_deg: 4.0
          pitch_deg: 3.0
          start: identity
        landmarks: {kind: path, count: 60, lateral_m: [1.5, 8.0], height_m: [-1.5, 3.0]}
        rig:
          fx_px: 552.554
          fy_px: 552.554
          cx_px: 682.049
          cy_px: 238.770
          baseline_m: 0.6
          image_px: [1242, 376]
          imu_cam: {translation_m: [1.1, -0.3, 0.7], rotation: optical, rotvec_deg: [0, 1, 0]}
          depth_m: [1.0, 12.0]
        imu:
          twist: mean
          velocity: {sigma: 0.2, bias_sigma: 0.0, bias_walk: 0.0}
          angular_velocity: {sigma: [0.02, 0.02, 0.03], bias_sigma: 0.0, bias_walk: 0.0}
          raw:
            rate_hz: 200.0
            gyro_noise_density: 1.7e-4
            accel_noise_density: 2.0e-3
            gyro_bias_walk: 1.9e-5
            accel_bias_walk: 3.0e-3
        camera:
          sigma_px: 0.7
          dropout: 0.0
          half_missing: 0.0
          outliers: {share: 0.0, size_px: 30.0}
          walls: [[0, 1, 2, 3, 4]]
        prior: {sigma_translation_m: 0.05, sigma_rotation_deg: 0.5}
        told:
          rotation_error_deg: [0.0, 0.0, 0.0]
          translation_error_m: [0.0, 0.0, 0.0]
          baseline_scale: 1.0
          pixel_sigma_scale: 1.0
          twist_sigma_scale: 1.0
        filter: {process_noise: twist, gate: none}
        """
    )
    assert scene.imu.angular_velocity.sigma == (0.02, 0.02, 0.03)
    assert scene.imu.raw.gyro_noise_density == 1.7e-4
    assert scene.filter.gate_probability is None
    assert loads("filter: {gate: 0.999}").filter.gate_probability == 0.999


numbers = st.floats(1e-12, 1e12, allow_subnormal=False)


@given(
    numbers=st.lists(numbers, min_size=4, max_size=4),
    about=st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"])),
    name=st.from_regex(r"\A[A-Za-z0-9_][A-Za-z0-9_.+-]{0,20}\Z"),
    kind=st.sampled_from(["circle", "random", f"waypoints, {WAYPOINTS}"]),
    seed=st.integers(0, 2**63 - 1),
)
def test_a_scene_comes_back_from_its_own_text_whatever_its_numbers_and_words(
    numbers, about, name, kind, seed
):
    a, b, c, d = numbers
    scene = loads(
        f"trajectory: {{kind: {kind}}}\n"
        f"camera: {{sigma_px: [{a!r}, {b!r}, {c!r}, {d!r}], outliers: {{size_px: {a!r}}}}}"
    ).model_copy(update={"about": about, "name": name, "seed": seed})
    again = loads(scene.to_yaml())
    assert again == scene
    assert again.fingerprint() == scene.fingerprint()


def test_text_that_looks_like_another_value_stays_text():
    for word in ("1e-4", "none", "null", "true", "0x10", "1:30", "no", "a: b", "007", "~", ".inf"):
        scene = Scenario(about=word)
        assert loads(scene.to_yaml()).about == word


def test_the_fingerprint_changes_with_any_value():
    prints = {
        loads(text).fingerprint()
        for text in ("", "seed: 1", "about: x", "rig: {fx_px: 552.5540000000001}", "name: a")
    }
    assert len(prints) == 5
    assert all(re.fullmatch("[0-9a-f]{12}", found) for found in prints)


def test_numbers_are_those_of_yaml_1_2():
    scene = loads("camera: {sigma_px: 1e-4}\nrig: {depth_m: [.5, 1E1]}\nabout: no")
    assert scene.camera.sigma_px == 1e-4
    assert scene.rig.depth_m == (0.5, 10.0)
    assert scene.about == "no"


def test_all_faults_are_told_at_once_each_with_line_and_key():
    assert faults(
        "name: a/b\n"
        "seed: 1\n"
        "seed: 2\n"
        "trajectory:\n"
        "  kind: circle\n"
        "  radius_m: -1\n"
        "  size_m: [1, 2]\n"
        "rig:\n"
        "  depth_m: [3, 1]\n"
        "  fx: 3\n"
        "imu: {velocity: {sigma: [0.1, -0.1, .nan]}}\n",
        "trajectory.laps=0",
    ) == [
        "scene.yaml:3: seed: given twice, first at scene.yaml:2; keep one",
        "scene.yaml:1: name: expected letters, digits and _ . + -, beginning with a letter or a "
        "digit, got 'a/b'",
        "scene.yaml:6: trajectory.radius_m: expected a number above 0, got -1",
        "--set trajectory.laps=0: trajectory.laps: expected a number above 0, got 0",
        "scene.yaml:7: trajectory.size_m: unknown key; expected one of kind, roll_deg, pitch_deg, "
        "roll_period_s, pitch_period_s, start, radius_m, laps",
        "scene.yaml:9: rig.depth_m: expected the smaller number first, got [3.0, 1.0]",
        "scene.yaml:10: rig.fx: unknown key; did you mean fx_px?",
        "scene.yaml:11: imu.velocity.sigma[1]: expected a number of at least 0, got -0.1",
        "scene.yaml:11: imu.velocity.sigma[2]: expected a finite number, got nan",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", "S:1: expected a mapping of sections, got 'hello'"),
        ("- 1", "S:1: expected a mapping of sections"),
        ("a: [1\nb: 2", "S:2: expected YAML: while parsing a flow sequence"),
        ("\x01", "S: expected YAML: .*control characters"),
        ("a: 1\n---\nb: 2", "S:2: expected YAML: expected a single document"),
        (
            "a: &x 1\nb: *x",
            r"S:2: expected YAML: the alias \*x is not allowed, write the value out",
        ),
        ("[" * 5000, "nested deeper than 20"),
        ("a: [" + "1," * 100_001 + "]", "more than 100000 values"),
        ("a: !!python/object:os.system x", "expected plain YAML, got the tag !!python"),
        ("? [1]\n: 2", "S:1: expected a word as key"),
        ("rig:", "S:1: rig: expected a mapping of keys, got nothing; leave the key out"),
        ("rig: 3", "S:1: rig: expected a mapping of keys, got 3"),
        ("seed: 1.0", "seed: expected a whole number, got 1.0"),
        ("seed: 1.5", "seed: expected a whole number, got 1.5"),
        ("seed: -1", "seed: expected a number of at least 0, got -1"),
        ("seed: " + "9" * 5000, "S:1: seed: expected plain YAML, got the tag !!int"),
        ("seed: true", "seed: expected a whole number, got True"),
        ("name: 7", "name: expected text, got 7"),
        ("name: ../x", "name: expected letters, digits"),
        ("name: a" + "b" * 99, "name: expected at most 80 characters"),
        ("rate_hz: 1e999", "rate_hz: expected a finite number, got inf"),
        ("rate_hz: 1" + "0" * 400, "rate_hz: expected a number, got 1000"),
        ("rate_hz: '10'", "rate_hz: expected a number, got '10'"),
        ("rate_hz:", "rate_hz: expected a number, got nothing"),
        ("duration_s: 0.09", "rate_hz: expected 1 to 1000000 intervals between frames"),
        ("duration_s: 1e9", "rate_hz: expected 1 to 1000000 intervals between frames"),
        ("time_jitter: 0.9", "time_jitter: expected a number below 0.9, got 0.9"),
        ("trajectory: {kind: loop}", "trajectory.kind: expected one of 'hover', .*, got 'loop'"),
        (
            "landmarks: {kind: box, center_m: here}",
            "landmarks.center_m: expected 'path', got 'here'",
        ),
        ("landmarks: {kind: shell, radius_m: [-1, 2]}", "expected radii of at least 0, got -1"),
        ("landmarks: {count: 0}", "landmarks.count: expected a number of at least 1, got 0"),
        ("trajectory: {kind: random, period_s: [0, 2]}", "expected periods above 0"),
        ("trajectory: {start: idenity}", "trajectory.start: expected 'identity' or 'given', got"),
        ("trajectory: {start: {rotvec_deg: [1, 2]}}", "expected another value, .* too short"),
        ("rig: {baseline_m: 0}", "rig.baseline_m: expected a number above 0, got 0"),
        ("rig: {depth_m: [0, 2]}", "rig.depth_m: expected depths above 0, got 0"),
        ("rig: {depth_m: [1, 2, 3]}", "rig.depth_m: expected a list of at most 2, got 3"),
        ("rig: {image_px: [3, 2.5]}", r"rig.image_px\[1\]: expected a whole number, got 2.5"),
        ("camera: {dropout: 1.5}", "camera.dropout: expected a number of at most 1, got 1.5"),
        ("camera: {sigma_px: 0}", "camera.sigma_px: expected a number above 0, got 0"),
        (
            "camera: {sigma_px: [1, 2, 3, true]}",
            r"camera.sigma_px\[3\]: expected a number, got True",
        ),
        ("camera: {tracks: {min_frames: 20}}", "expected at most median_frames, 10, got 20"),
        ("camera: {tracks: {max_frames: 9}}", "expected at least median_frames, 10, got 9"),
        (
            "camera: {walls: [[0, 0, 1, 0, 0]]}",
            r"camera.walls\[0\]\[4\]: expected a number above 0",
        ),
        ("filter: {gate: 1}", "filter.gate: expected a number below 1, got 1"),
        ("filter: {gate: None}", "filter.gate: expected 'none', got 'None'"),
        (
            "trajectory: {kind: waypoints, points: [[0, 0, 0]]}",
            "trajectory.points: expected a list of at least 2, got 1",
        ),
        (
            "trajectory: {kind: waypoints, points: [[0, 0, 0], [0, 0, 0]]}",
            "trajectory.points: expected points that differ",
        ),
        (
            f"trajectory: {{kind: waypoints, {WAYPOINTS}, times_s: [0, 2, 2]}}",
            "trajectory.times_s: expected increasing times, got 2.0 after 2.0",
        ),
        (
            f"trajectory: {{kind: waypoints, {WAYPOINTS}, times_s: [1, 2, 3]}}",
            "trajectory.times_s: expected the first time to be 0, got 1.0",
        ),
        (
            f"trajectory: {{kind: waypoints, {WAYPOINTS}, times_s: [-5, 2, 3]}}",
            "trajectory.times_s: expected the first time to be 0, got -5.0",
        ),
        (
            f"trajectory: {{kind: waypoints, {WAYPOINTS}, times_s: [0, 2]}}",
            "trajectory.times_s: expected one for each of the 3 points, got 2",
        ),
        (
            f"trajectory: {{kind: waypoints, {WAYPOINTS}, quaternions: [[0, 0, 0, 1], [0, 0, 0, 2],"
            " [0, 0, 0, 1]]}",
            "trajectory.quaternions: expected quaternions of length 1",
        ),
        (
            f"trajectory: {{kind: waypoints, {WAYPOINTS}, times_s: [0, 2, 4]}}\nduration_s: 5",
            "S:2: duration_s: expected at most 4.0, where the trajectory ends, got 5.0",
        ),
        ("trajectory: {kind: file}", "trajectory.path: expected the name of a file, got nothing"),
        ("trajectory: {kind: file, path: }", "trajectory.path: expected the name of a file"),
        ("trajectory: {kind: file, path: 3}", "trajectory.path: expected text, got 3"),
        ("trajectory: {kind: file, path: no.tum}", "trajectory.path: no.tum: expected a file"),
        (
            "trajectory: {kind: file, path: /dev}",
            "/dev: expected a file that can be read: Is a directory",
        ),
        ("trajectory: {kind: file, path: a, text: b}", "trajectory.text: expected path or text"),
        ("trajectory: {kind: file, text: 0 0 0 0 0 0 0 1}", "expected at least two poses, got one"),
        ("landmarks: {kind: file, text: 1 2}", "landmarks.text: text:1: expected 3 numbers, got 2"),
        ("landmarks: {kind: file, path: no.npy}", "landmarks.path: no.npy: expected a file"),
    ],
)
def test_a_fault_says_where_it_is_and_what_was_expected(text, message):
    with pytest.raises(ScenarioError, match=message):
        loads(text, where="S")


@given(st.data())
def test_whatever_a_file_holds_the_answer_is_a_scene_or_its_faults(data):
    keys = st.sampled_from(
        [*Scenario.model_fields, "kind", "sigma", "depth_m", "start", "raw", "x"]
    )
    values = st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | keys,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=4),
        max_leaves=15,
    )
    content = data.draw(st.dictionaries(keys, values, max_size=5) | values)
    text = data.draw(st.sampled_from([json.dumps(content), str(content)]))
    overrides = data.draw(st.lists(st.text(max_size=8), max_size=1))
    try:
        found = loads(text, overrides=overrides)
    except ScenarioError as error:
        found = error
    assert isinstance(found, Scenario) or all(fault.message for fault in found.faults)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("seed", "--set seed: expected key.path=value"),
        ("a..b=1", "expected key.path=value"),
        ("camera.sigma_px=[1", "--set .*: camera.sigma_px: expected YAML"),
        (
            "camera.sigma_px=",
            "--set camera.sigma_px=: camera.sigma_px: expected a number, got noth",
        ),
        ("seed.x=1", "--set seed.x=1: seed.x: expected a section above it, but seed is 3"),
        ("camera.sigma=1", "camera.sigma: unknown key; did you mean sigma_px?"),
        ("rig={fx_px: x}", r"--set rig=\{fx_px: x\}: rig.fx_px: expected a number, got 'x'"),
    ],
)
def test_a_fault_in_an_option_names_the_option(override, message):
    with pytest.raises(ScenarioError, match=message):
        loads("seed: 3", overrides=[override])


def test_options_set_values_in_their_order_and_make_sections_that_are_not_there():
    scene = loads(
        "trajectory: {kind: circle}",
        overrides=["camera.sigma_px=1e-1", "rig.depth_m=[2, 8]", "camera.sigma_px=0.3", "seed=5"],
    )
    assert (scene.camera.sigma_px, scene.rig.depth_m, scene.seed) == (0.3, (2.0, 8.0), 5)
    assert loads("", overrides=["trajectory.laps=3"]).trajectory.laps == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "expected a file that can be read: No such file"),
        (b"\xff\xfe\x00", "expected text in UTF-8"),
        (b"\x00\x01", "expected YAML"),
        (b" " * (32 * 2**20 + 1), "a text of this length takes"),
    ],
)
def test_a_file_that_is_no_text_is_refused_by_name(tmp_path, content, message):
    path = tmp_path / "scene.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ScenarioError, match=f"^{re.escape(str(path))}: {message}"):
        load(path)


def test_a_directory_is_refused(tmp_path):
    with pytest.raises(ScenarioError, match="expected a file that can be read: Is a directory"):
        load(tmp_path)


def test_files_that_a_scene_names_are_embedded_and_no_longer_needed(tmp_path):
    (tmp_path / "a.tum").write_text("# t\n100 0 0 0 0 0 0 1\n101.5 1 2 3 0 0 0.6 0.8\n")
    (tmp_path / "b.csv").write_text("0, 1, 2\n1, 2, 1e-7\n")
    np.save(tmp_path / "c.npy", np.array([[0, 1, 2], [1, 2, 1e-7]]))
    (tmp_path / "s.yaml").write_text(
        "trajectory: {kind: file, path: a.tum}\nlandmarks: {kind: file, path: b.csv}\n"
    )
    scene = load(tmp_path / "s.yaml")
    other = load(tmp_path / "s.yaml", ["landmarks.path=c.npy"])
    for path in tmp_path.iterdir():
        path.unlink()
    assert loads(scene.to_yaml()) == scene == other
    assert scene.duration_s == 1.5
    assert scene.landmarks.text == "0.0 1.0 2.0\n1.0 2.0 1e-07\n"


@pytest.mark.parametrize(
    "array",
    [np.zeros((3, 2)), np.zeros(3), np.full((1, 3), np.nan), np.zeros((0, 3)), np.array(["a"])],
)
def test_an_array_that_holds_no_points_is_refused(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(ScenarioError, match=r"landmarks.path: .*a.npy: expected"):
        loads("landmarks: {kind: file, path: a.npy}", base_dir=tmp_path)


def test_a_pickled_array_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{}], object), allow_pickle=True)
    with pytest.raises(
        ScenarioError, match=r"landmarks.path: .*a.npy: expected an array of numbers"
    ):
        loads("landmarks: {kind: file, path: a.npy}", base_dir=tmp_path)


def test_the_camera_looks_ahead_with_its_own_turn_on_top():
    rig = loads("rig: {imu_cam: {translation_m: [1, 2, 3]}}").rig
    forward_right_down = (
        rig.T_imu_cam @ np.array([[2, 0.5, 0.25, 1], [0, 0, 0, 1]])[:, [1, 2, 0, 3]].T
    )
    np.testing.assert_allclose(forward_right_down[:3, 0], [3, 1.5, 2.75])
    np.testing.assert_allclose(forward_right_down[:3, 1], [1, 2, 3])
    turned = loads("rig: {imu_cam: {rotvec_deg: [0, 0, 90]}}").rig.T_imu_cam
    np.testing.assert_allclose(turned[:3, 2], [0, 1, 0], atol=1e-15)  # optical axis to the left


def test_a_scene_cannot_be_changed():
    with pytest.raises(ValueError, match="frozen"):
        Scenario().rig.fx_px = 3


def test_the_schema_on_file_is_that_of_the_models():
    assert schema.text() == schema.generated(), "write it: python -m simbench.scenario.schema"


def test_the_schema_knows_every_section_and_kind():
    described = json.loads(json.dumps(Scenario.json_schema()))
    assert set(described["properties"]) == set(Scenario.model_fields)
    assert set(described["properties"]["trajectory"]["discriminator"]["mapping"]) == set(
        scenario.TRAJECTORIES
    )
    assert set(described["properties"]["landmarks"]["discriminator"]["mapping"]) == set(
        scenario.LANDMARKS
    )


@pytest.mark.parametrize(
    ("union", "table"),
    [(TrajectoryKind, scenario.TRAJECTORIES), (LandmarkKind, scenario.LANDMARKS)],
)
def test_the_tables_of_kinds_list_the_models(union, table):
    models = union.__origin__.__args__
    assert {model.model_fields["kind"].default for model in models} == set(table)
    assert all(table.values())
