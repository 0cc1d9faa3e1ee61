"""Laws of the recording format: what is written is read back, and bad files are refused in one clear line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from softrl.core.errors import RecordingError
from softrl.recordings.read import read
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.write import write
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"


def robot_named(name: str) -> Robot:
    return Robot(**yaml.safe_load((CONF / "robot" / f"{name}.yaml").read_text()))


@pytest.fixture
def tripod() -> Robot:
    return robot_named("tripod")


def example_set(robot: Robot, seed: int = 3) -> RecordingSet:
    rng = np.random.default_rng(seed)
    runs = []
    for k, session in enumerate(["2020_0908", "2020_0908", "b"]):
        time = np.cumsum(rng.uniform(0.005, 0.02, 40 + k))
        rotvec = np.cumsum(rng.normal(0.0, 0.02, (len(time), 3)), axis=0)
        runs.append(
            Recording(
                name=f"2020_0908_{k}",
                session=session,
                time=time,
                pressure_cmd=rng.uniform(-20e3, 35e3, (len(time), robot.chambers)),
                pressure_meas=rng.uniform(-20e3, 35e3, (len(time), robot.chambers)),
                position=np.array([0.0, 0.0, robot.length_m]) + rng.normal(0.0, 0.01, (len(time), 3)),
                quaternion=Rotation.from_rotvec(rotvec).as_quat(scalar_first=True),
                bend_angle=rng.normal(0.0, 0.3, len(time)) if k == 1 else None,
                tip_force=rng.normal(0.0, 1.0, (len(time), 3)) if k != 2 else None,
                markers={"marker3": rng.normal(0.0, 0.1, (len(time), 3))} if k == 0 else {},
                temperature=rng.normal(22.0, 1.0, len(time)) if k == 2 else None,
            )
        )
    return RecordingSet(robot.name, tuple(runs), {"what": "an example", "session_notes": {"b": {"what": "more"}}})


def assert_same(one: RecordingSet, other: RecordingSet) -> None:
    assert (one.robot_name, one.sessions(), one.notes) == (other.robot_name, other.sessions(), other.notes)
    for a, b in zip(one.recordings, other.recordings, strict=True):
        assert (a.name, a.session) == (b.name, b.session)
        assert [c for c, _ in a.channels()] == [c for c, _ in b.channels()]
        for (channel, values), (_, read_back) in zip(a.channels(), b.channels(), strict=True):
            np.testing.assert_allclose(read_back, values, rtol=2e-8, atol=1e-9, err_msg=f"{a.name} {channel}")


def test_written_recordings_are_read_back(tripod: Robot, tmp_path: Path) -> None:
    recordings = example_set(tripod)
    write(tmp_path / "set", recordings)
    assert_same(recordings, read(tmp_path / "set", tripod))


def test_artifact_is_a_dataset_folder(tripod: Robot, tmp_path: Path) -> None:
    recordings = example_set(tripod)
    recordings.save(tmp_path / "artifact")
    assert_same(recordings, RecordingSet.load(tmp_path / "artifact"))
    assert_same(recordings, read(tmp_path / "artifact", tripod))


def test_writing_twice_gives_equal_bytes(tripod: Robot, tmp_path: Path) -> None:
    write(tmp_path / "a", example_set(tripod))
    write(tmp_path / "b", read(tmp_path / "a", tripod))
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


@pytest.mark.parametrize("axis", ["+x", "-x", "+y", "-y", "-z"])
def test_session_axis_becomes_the_robots_axis(axis: str, tripod: Robot, tmp_path: Path) -> None:
    along = np.zeros(3)
    along["xyz".index(axis[1])] = -tripod.length_m if axis[0] == "-" else tripod.length_m
    time = 0.01 * np.arange(1.0, 6.0)
    still = Recording(
        "run",
        "s",
        time,
        np.full((5, 3), 1e4),
        position=np.tile(along, (5, 1)),
        quaternion=np.tile([1.0, 0, 0, 0], (5, 1)),
    )
    write(tmp_path, RecordingSet("tripod", (still,)))
    text = (tmp_path / "dataset.yaml").read_text().replace("  s:\n", f"  s:\n    axis: '{axis}'\n")
    (tmp_path / "dataset.yaml").write_text(text)
    turned = read(tmp_path, tripod).recordings[0]
    np.testing.assert_allclose(turned.position, np.tile([0, 0, tripod.length_m], (5, 1)), atol=1e-9)
    np.testing.assert_allclose(turned.quaternion, still.quaternion, atol=1e-12)


def test_dataset_without_sessions_has_one_a_run(tripod: Robot, tmp_path: Path) -> None:
    write(tmp_path, example_set(tripod))
    (tmp_path / "dataset.yaml").write_text("robot: tripod\n")
    (tmp_path / "2020_0908_1.csv").rename(tmp_path / "2020_0908_10.csv")  # later than 2, as people count
    assert read(tmp_path, tripod).sessions() == ["2020_0908_0", "2020_0908_2", "2020_0908_10"]


def test_other_command_is_scaled(tmp_path: Path) -> None:
    finger = robot_named("single_chamber_finger")
    (tmp_path / "dataset.yaml").write_text("robot: single_chamber_finger\n")
    (tmp_path / "a.csv").write_text("time_ms,pump_pwm_cmd,p1_meas_kpa,bend_angle_deg\n0,0,0.0,0\n30,100,2.5,90\n")
    run = read(tmp_path, finger).recordings[0]
    np.testing.assert_allclose(run.time, [0.0, 0.03])
    np.testing.assert_allclose(run.pressure_cmd, [[0.0], [100.0 * finger.command_to_pa]])
    np.testing.assert_allclose(run.bend_angle, [0.0, np.pi / 2])


@pytest.mark.parametrize(
    ("angles", "lowest_deg", "refused"), [((90, 270), -30, True), ((0, 180), -30, False), ((90, 270), -1, False)]
)
def test_an_angle_has_a_sign_only_where_chambers_lie_on_a_line(
    tmp_path: Path, angles: tuple[float, ...], lowest_deg: float, refused: bool
) -> None:
    robot = replace(robot_named("tripod"), chamber_angle_deg=(0.0, *angles), output="bend_angle")
    (tmp_path / "dataset.yaml").write_text("robot: tripod\n")
    rows = "".join(f"{0.01 * k},{k % 9},0,0,{lowest_deg + k}\n" for k in range(100))
    (tmp_path / "a.csv").write_text("time_s,p1_cmd_kpa,p2_cmd_kpa,p3_cmd_kpa,bend_angle_deg\n" + rows)
    if not refused:
        assert np.degrees(read(tmp_path, robot).recordings[0].bend_angle).min() == pytest.approx(lowest_deg)
        return
    with pytest.raises(RecordingError, match=r"a.csv, line 2, column 'bend_angle_deg': -30 is negative; .* has no sign"):
        read(tmp_path, robot)


GOOD = "time_s,p1_cmd_kpa,p2_cmd_kpa,p3_cmd_kpa,tip_x_mm,tip_y_mm,tip_z_mm\n"
ROWS = "0.01,5,0,0,0,0,176\n0.02,5,1,0,0,0,176\n0.03,5,2,0,1,0,176\n"


@pytest.mark.parametrize(
    ("header", "rows", "expected"),
    [
        (GOOD.replace("p3_cmd_kpa", "p3_cmd_kelvin"), ROWS, ["line 1", "p3_cmd_kelvin", "no unit of Pa"]),
        (GOOD.replace("tip_z_mm", "tip_w_mm"), ROWS, ["line 1", "unknown column 'tip_w_mm'", "tip_x_mm"]),
        (GOOD.replace("tip_z_mm", "temp_c"), ROWS, ["line 1", "position needs 3", "tip_x_mm, tip_y_mm"]),
        (
            GOOD.replace("p3_cmd_kpa", "temp_c"),
            ROWS,
            ["pressure_cmd needs 3", "tripod", "p1_cmd_kpa, p2_cmd_kpa"],
        ),
        (GOOD.replace("p3_cmd_kpa", "p2_cmd_kpa"), ROWS, ["p2_cmd_kpa", "second time"]),
        (GOOD.replace("time_s,", "temp_c,"), ROWS, ["'time_s' is missing"]),
        (GOOD.replace("_cmd", "_meas"), ROWS, ["'p1_cmd_kpa' is missing"]),
        (
            GOOD.replace("p1_cmd_kpa", "valve_cmd"),
            ROWS,
            ["unknown column 'valve_cmd'", "robot.command=pressure"],
        ),
        (GOOD, ROWS.replace("0.02,5,1", "0.02,nan,1"), ["line 3", "'p1_cmd_kpa'", "nan"]),
        (GOOD, ROWS.replace("0.02,5,1", "0.02,five,1"), ["line 3", "'p1_cmd_kpa'", "'five' is no number"]),
        (GOOD, ROWS.replace("0.02,5,1", "0.02,,1"), ["line 3", "'p1_cmd_kpa'", "'' is no number"]),
        (GOOD, ROWS.replace("0.02,5,1", "0.02,5,1,7"), ["line 3", "8 values for 7 columns"]),
        (GOOD, ROWS.replace("0.03", "0.02"), ["line 4", "'time_s'", "0.02 does not exceed 0.02"]),
        (
            GOOD,
            ROWS.replace("0.0", "10.0").replace("10.03", "4000"),
            ["'time_s'", "sampling period", "time_ms"],
        ),
        (
            GOOD,
            ROWS.replace(",5,2", ",5,40"),
            ["line 4", "'p2_cmd_kpa'", "40000 Pa", "-20000 to 35000 Pa", "clip"],
        ),
        (GOOD, ROWS.replace(",5,", ",5000,"), ["line 2", "'p1_cmd_kpa'", "20 times", "another unit"]),
        (GOOD.replace("cmd_kpa", "cmd_pa"), ROWS, ["'p1_cmd_pa'", "another unit"]),
        (
            GOOD.replace("x_mm", "x_m").replace("y_mm", "y_m").replace("z_mm", "z_m"),
            ROWS,
            ["'tip_x_m'", "176", "another unit"],
        ),
        (GOOD, ROWS.replace("176", "0.176"), ["'tip_x_mm'", "never is farther"]),
        (GOOD, "", ["holds 0 samples"]),
        ("", "", ["is empty"]),
        (GOOD.replace(",", ";"), ROWS.replace(",", ";"), ["line 1", "semicolons", "'time_s;p1_cmd", "expected commas: "]),
        (GOOD.replace(",", ";"), ROWS.replace(",", ";").replace(".", ","), ["semicolons", "points in decimals"]),
        (GOOD.replace(",", "\t"), ROWS.replace(",", "\t"), ["line 1", "tabs", "expected commas"]),
        (GOOD, ROWS.replace(".", ","), ["line 2", "8 values for 7 columns", "expected 7", "decimals"]),
        (GOOD.replace("tip_x_mm", "tip_x"), ROWS, ["column 5", "unknown column 'tip_x'", "did you mean 'tip_x_mm'"]),
        *(
            (GOOD.replace("\n", f",{name}\n"), ROWS.replace("\n", ",0\n"), ["column 8", f"'{name}'", f"did you mean '{meant}'?"])
            for name, meant in (
                ("marker1_x", "marker1_x_mm"), ("marker_2_y_mm", "marker2_y_mm"), ("Marker3_z_mm", "marker3_z_mm"),
                ("marker_x_mm", "marker1_x_mm"), ("mark1_x_mm", "marker1_x_mm"), ("marker12_x", "marker12_x_mm"),
            )
        ),
        (GOOD.replace("time_s", "Time_s"), ROWS, ["column 1", "did you mean 'time_s'"]),
        (GOOD.replace("time_s", "time_us"), ROWS, ["'time_us' is in 'us'", "expected s, ms"]),
        (GOOD.replace("time_s", "time_ms"), ROWS, ["'time_ms'", "1e-05 s", "time_s"]),
        (GOOD.replace("\n", ",p1_meas_pa,p2_meas_pa,p3_meas_pa\n"), ROWS.replace("\n", ",5,0,0\n"), ["p1_meas_pa", "unit?"]),
        (GOOD.replace("\n", ",force_x_n,force_y_n,force_z_n\n"), ROWS.replace("\n", ",0,0,900\n"), ["900 N", "unit?"]),
        (GOOD.replace("\n", ",bend_angle_rad\n"), ROWS.replace("\n", ",45\n"), ["45 rad", "another unit?"]),
    ],
)
def test_bad_file_is_refused_in_one_line(
    header: str, rows: str, expected: list[str], tripod: Robot, tmp_path: Path
) -> None:
    (tmp_path / "dataset.yaml").write_text("robot: tripod\n")
    (tmp_path / "a.csv").write_text(header + rows)
    with pytest.raises(RecordingError) as caught:
        read(tmp_path, tripod)
    message = str(caught.value)
    assert "\n" not in message and "a.csv" in message
    for part in expected:
        assert part in message, message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, ["dataset.yaml is missing"]),
        ("frame: base\n", ["'robot' is missing"]),
        ("robot: [\n", ["no YAML"]),
        ("robot: gripper\n", ["'gripper'", "choose robot=gripper"]),
        ("robot: tripod\nsessions: {s: {runs: [a, b]}}\n", ["run 'b'", "b.csv does not exist", "found a"]),
        ("robot: tripod\nsessions: {s: {runs: []}}\n", ["session 's'", "runs"]),
        ("robot: tripod\nsessions: {s: {runs: [a]}, t: {runs: [a]}}\n", ["run 'a'", "2 times"]),
        ("robot: tripod\nsessions: {s: {runs: [a], axis: up}}\n", ["axis 'up'", "+z"]),
        ("robot: tripod\nsessions: {s: {runs: [a], axes: +y}}\n", ["session 's'", "key 'axes'", "did you mean axis"]),
        *(
            (f"robot: tripod\nsessions: {{s: {{runs: [a], {key}: [a]}}}}\n", ["session 's'", f"key '{key}'", "at the top"])
            for key in ("command_acts", "disturbed", "out_of_distribution")
        ),
        ("robot: tripod\nsessions:\n  s: [a]\n  s: [a]\n", ["key 's' is there 2 times"]),
        ("robot: tripod\naxis: +y\n", ["key 'axis'", "within a session"]),
        ("robot: tripod\nsessions: [a]\n", ["sessions must map"]),
        ("robot: tripod\ndisturbed: [bumpd]\n", ["disturbed names 'bumpd'", "found a"]),
    ],
)
def test_bad_dataset_is_refused_in_one_line(
    text: str | None, expected: list[str], tripod: Robot, tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text(GOOD + ROWS)
    if text is not None:
        (tmp_path / "dataset.yaml").write_text(text)
    with pytest.raises(RecordingError) as caught:
        read(tmp_path, tripod)
    assert "\n" not in str(caught.value)
    for part in expected:
        assert part in str(caught.value), str(caught.value)


def test_columns_of_other_names_are_left_out_and_told(tripod: Robot, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "dataset.yaml").write_text("robot: tripod\n")
    (tmp_path / "a.csv").write_text(GOOD + ROWS)
    plain = read(tmp_path, tripod)
    lines = (GOOD + ROWS).splitlines()
    more = [f"operator,{line},flow_slpm,marker_id" if k == 0 else f"anna,{line},0.5,3" for k, line in enumerate(lines)]
    (tmp_path / "a.csv").write_text("\n".join(more) + "\n")
    assert_same(read(tmp_path, tripod), plain)
    assert "left out: operator, flow_slpm, marker_id" in caplog.text


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-8"])
def test_a_byte_order_mark_and_quoted_names_change_nothing(encoding: str, tripod: Robot, tmp_path: Path) -> None:
    (tmp_path / "dataset.yaml").write_text("robot: tripod\n", encoding=encoding)
    quoted = '"' + GOOD.strip().replace(",", '","') + '"\r\n'
    (tmp_path / "a.csv").write_text(quoted + ROWS, encoding=encoding)
    assert read(tmp_path, tripod).recordings[0].position is not None


@pytest.mark.parametrize("name", ["a.csv", "dataset.yaml"])
def test_a_file_in_another_encoding_is_refused(name: str, tripod: Robot, tmp_path: Path) -> None:
    for file, text in (("dataset.yaml", "robot: tripod\n"), ("a.csv", GOOD + ROWS)):
        (tmp_path / file).write_text(text, encoding="utf-16" if file == name else "utf-8")
    with pytest.raises(RecordingError, match=f"{name}: byte 0 is no UTF-8"):
        read(tmp_path, tripod)


def test_missing_folder_and_empty_folder(tripod: Robot, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is no folder"):
        read(tmp_path / "nowhere", tripod)
    (tmp_path / "dataset.yaml").write_text("robot: tripod\n")
    with pytest.raises(RecordingError, match="names no runs"):
        read(tmp_path, tripod)


def test_poses_may_be_a_minute_apart_and_no_more(tripod: Robot, tmp_path: Path) -> None:
    (tmp_path / "dataset.yaml").write_text("robot: tripod\n")

    def written(period_s: float, column: str = "time_s") -> None:
        rows = "".join(f"{period_s * k},{k % 5},0,0,{k % 5},0,176\n" for k in range(1, 20))
        (tmp_path / "a.csv").write_text(GOOD.replace("time_s", column) + rows)

    for period_s in (6.0, 30.0, 60.0):
        written(period_s)
        assert np.diff(read(tmp_path, tripod).recordings[0].time) == pytest.approx(period_s)
    written(100.0)
    expected = "expected 5e-05 to 60 s; if these are milliseconds, 0.1 s, name the column time_ms; else leave out pauses"
    with pytest.raises(RecordingError, match=expected):
        read(tmp_path, tripod)
    written(1e5, "time_ms")
    with pytest.raises(RecordingError, match=r"period is 100 s; expected 5e-05 to 60 s; leave out pauses"):
        read(tmp_path, tripod)


def test_milliseconds_that_are_called_seconds_are_no_table_of_poses(tripod: Robot, tmp_path: Path) -> None:
    (tmp_path / "dataset.yaml").write_text("robot: tripod\n")
    rows = "".join(f"{10 * k},{k % 5},0,0,{k % 5},0,176\n" for k in range(4000))
    (tmp_path / "a.csv").write_text(GOOD + rows)
    with pytest.raises(RecordingError, match=r"period is 10 s; .*, in 11.1 h; if these are milliseconds, 0.01 s, name"):
        read(tmp_path, tripod)
    (tmp_path / "a.csv").write_text(GOOD.replace("time_s", "time_ms") + rows)
    assert np.ptp(read(tmp_path, tripod).recordings[0].time) == pytest.approx(39.99)
