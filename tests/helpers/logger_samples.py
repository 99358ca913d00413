"""One small log of a two-joint arm as each logger writes it.

The same numbers in all of them, so that a test can compare what is read.
"""

import datetime
import json
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from small_runs import small_run

from sdp_vs_penalty import Measurements, load_problem

#: When the logs with stamps of the day begin [s since 1970].
START = 1_740_000_000
JOINTS = ("joint_1", "joint_2")


@cache
def sample_run() -> Measurements:
    """Eight seconds of the two-link arm at 50 Hz, of five decimals."""
    run = small_run(load_problem("two_link"), seconds=8.0, rate=50.0)
    q, dq, tau = (np.round(x, 5) for x in (run.q, run.dq, run.tau))
    return Measurements(np.round(run.t, 6), q, tau, dq)


def _write(
    path: Path, head: Sequence[str] | None, columns: Sequence[object], mark: str = ","
) -> None:
    """Columns of texts or numbers as one text table."""
    rows = zip(*(map(_cell, column) for column in columns), strict=True)  # type: ignore[call-overload]
    lines = [] if head is None else [mark.join(head)]
    path.write_text("\n".join([*lines, *map(mark.join, rows)]) + "\n")


def _cell(x: object) -> str:
    return x if isinstance(x, str) else f"{x:.10g}"


def _numbered(*patterns: str) -> list[str]:
    """Names by patterns like "q_{}", counted from 0."""
    return [pattern.format(k) for pattern in patterns for k in range(2)]


def _blocks(*blocks: np.ndarray) -> list[np.ndarray]:
    return [column for block in blocks for column in block.T]


def rtde(path: Path, run: Measurements) -> None:
    names = _numbered("actual_q_{}", "actual_qd_{}", "actual_current_{}", "target_q_{}")
    columns = [1234.5 + run.t, *_blocks(run.q, run.dq, run.tau, run.q + 1e-4)]
    _write(path, ["timestamp", *names], columns, " ")


def rtde_torque(path: Path, run: Measurements) -> None:
    """As the controller makes torques of currents."""
    fields = ("actual_q_{}", "actual_qd_{}", "actual_current_as_torque_{}")
    columns = [1234.5 + run.t, *_blocks(run.q, run.dq, run.tau)]
    _write(path, ["timestamp", *_numbered(*fields)], columns, " ")


def rtde_controller(path: Path, run: Measurements) -> None:
    names = _numbered("actual_q_{}", "actual_qd_{}", "target_moment_{}")
    columns = [1234.5 + run.t, *_blocks(run.q, run.dq, run.tau)]
    _write(path, ["timestamp", *names], columns, " ")


def rostopic(path: Path, run: Measurements) -> None:
    fields = _numbered(*(f"field.{x}{{}}" for x in ("position", "velocity", "effort")))
    stamps = [str(START * 10**9 + round(1e9 * t)) for t in run.t]
    names = [[joint] * len(run.t) for joint in JOINTS[::-1]]
    blocks = _blocks(*(x[:, ::-1] for x in (run.q, run.dq, run.tau)))
    empty = [""] * len(run.t)
    head = ["%time", "field.header.frame_id", *_numbered("field.name{}"), *fields]
    _write(path, head, [stamps, empty, *names, *blocks])


def ros2_echo(path: Path, run: Measurements) -> None:
    seconds, nanoseconds = _two_parts(run)
    names = [[joint] * len(run.t) for joint in JOINTS[::-1]]
    blocks = _blocks(*(x[:, ::-1] for x in (run.q, run.dq, run.tau)))
    _write(path, None, [seconds, nanoseconds, [""] * len(run.t), *names, *blocks])


def bagpy(path: Path, run: Measurements) -> None:
    seconds, nanoseconds = _two_parts(run)
    names = [[joint] * len(run.t) for joint in JOINTS]
    head = ["Time", "header.seq", "header.stamp.secs", "header.stamp.nsecs"]
    head += _numbered("name_{}", "position_{}", "velocity_{}", "effort_{}")
    late = [f"{START + t + 0.001:.4f}" for t in run.t]
    blocks = _blocks(run.q, run.dq, run.tau)
    count = list(range(len(run.t)))
    _write(path, head, [late, count, seconds, nanoseconds, *names, *blocks])


def flattened(path: Path, run: Measurements) -> None:
    seconds, nanoseconds = _two_parts(run)
    fields = [f"{joint}_{x}" for x in ("position", "effort") for joint in JOINTS]
    head = ["header.stamp.sec", "header.stamp.nanosec", *fields]
    _write(path, head, [seconds, nanoseconds, *_blocks(run.q, run.tau)])


def mujoco(path: Path, run: Measurements) -> None:
    head = ["time", *_numbered("qpos_{}", "qvel_{}", "qfrc_actuator_{}")]
    _write(path, head, [run.t, *_blocks(run.q, run.dq, run.tau)])


def franka(path: Path, run: Measurements) -> None:
    fields = ("state.q[{}]", "state.q_d[{}]", "state.dq[{}]", "state.tau_J[{}]")
    head = ["time", "success_rate", *_numbered(*fields)]
    blocks = _blocks(run.q, run.q + 1e-4, run.dq, run.tau)
    _write(path, head, [1e3 * run.t, np.ones(len(run.t)), *blocks])


def franka_old(path: Path, run: Measurements) -> None:
    fields = ("q[{}]", "q_d[{}]", "dq[{}]", "tau_J[{}]", "tau_ext_hat_filtered[{}]")
    head = ["duration", " success rate", *_numbered(*fields)]
    blocks = _blocks(run.q, run.q + 1e-4, run.dq, run.tau, 0.1 * run.tau)
    _write(path, head, [1e3 * run.t, np.ones(len(run.t)), *blocks], ", ")


def kuka_rsi(path: Path, run: Measurements) -> None:
    """Degrees, a clock in milliseconds, and currents in per cent."""
    names = ("AIPos.A{}", "ASPos.A{}", "MACur.A{}")
    head = ["IPOC", *(name.format(k) for name in names for k in (1, 2))]
    blocks = _blocks(np.degrees(run.q), np.degrees(run.q) + 0.01, run.tau)
    _write(path, head, [1e3 * run.t, *blocks])


def kuka_variables(path: Path, run: Measurements) -> None:
    """Degrees and Nm, by the names of the controller's variables."""
    names = ("$AXIS_ACT.A{}", "$TORQUE_AXIS_ACT[{}]")
    head = ["time", *(name.format(k) for name in names for k in (1, 2))]
    _write(path, head, [run.t, *_blocks(np.degrees(run.q), run.tau)])


def kuka_rsi_torque(path: Path, run: Measurements) -> None:
    """Degrees, a clock in milliseconds, and torques in Nm."""
    names = ("AIPos.A{}", "$TORQUE_AXIS_ACT[{}]")
    head = ["IPOC", *(name.format(k) for name in names for k in (1, 2))]
    _write(path, head, [1e3 * run.t, *_blocks(np.degrees(run.q), run.tau)])


def abb_rapid(path: Path, run: Measurements) -> None:
    """Degrees and Nm, by the names of a robjoint."""
    names = ("rax_{}", "torque_{}")
    head = ["time", *(name.format(k) for name in names for k in (1, 2))]
    _write(path, head, [run.t, *_blocks(np.degrees(run.q), run.tau)])


def plotjuggler(path: Path, run: Measurements) -> None:
    """Sparse: every row belongs to one of two topics."""
    head = ["__time"]
    head += [f"/joint_states/{j}/{x}" for j in JOINTS for x in ("position", "effort")]
    rows = [",".join([*head, "/battery/voltage"])]
    for k, t in enumerate(run.t):
        q, tau = run.q[k], run.tau[k]
        cells = [f"{START + t:.6f}", q[0], tau[0], q[1], tau[1]]
        rows.append(",".join(map(str, cells)) + ",")
        rows.append(f"{START + t + 0.004:.6f},,,,,{24.0 + 0.01 * k:.2f}")
    path.write_text("\n".join(rows) + "\n")


def pyfri(path: Path, run: Measurements) -> None:
    """Measured and interpolated positions, measured and external torques."""
    seconds, nanoseconds = _two_parts(run)
    head = ["index", "time", "record_time_nsec", "tsec", "tnsec"]
    head += [f"{word}{k}" for word in ("mp", "ip", "mt", "et") for k in (1, 2)]
    count = [str(k) for k in range(len(run.t))]
    blocks = _blocks(run.q, run.q + 1e-4, run.tau, 0.1 * run.tau)
    stamps = [str(START * 10**9 + round(1e9 * t) + 1000) for t in run.t]
    columns = [count, run.t, stamps, seconds, nanoseconds, *blocks]
    _write(path, [*head, "dt"], [*columns, np.full(len(run.t), 0.02)])


def kortex(path: Path, run: Measurements) -> None:
    """Feedback of the actuators; angles from 0 to 360 degrees."""
    words = ("position", "velocity", "torque", "current_motor")
    names = _numbered(*(f"actuators[{{}}].{word}" for word in words))
    degrees = np.degrees(run.q) % 360.0, np.degrees(run.dq)
    columns = [run.t, *_blocks(*degrees, run.tau, 0.3 * run.tau)]
    _write(path, ["time", *names], columns)


def lerobot_current(path: Path, run: Measurements) -> None:
    """As :func:`lerobot`, with the currents of the motors."""
    lerobot(path, run, "current")


def lerobot(path: Path, run: Measurements, word: str = "effort") -> None:
    """Two episodes, positions in degrees, as the columns' metadata say; ``word``: what
    the torques are called."""
    import pyarrow as arrow
    from pyarrow import parquet

    half = len(run.t) // 2
    episode = np.arange(len(run.t)) // half
    degrees = np.degrees(run.q).astype(np.float32)
    columns = {
        "action": list(degrees),
        "observation.state": list(degrees),
        f"observation.{word}": list(run.tau.astype(np.float32)),
        "timestamp": (run.t - half / 50.0 * episode).astype(np.float32),
        "frame_index": np.arange(len(run.t)) % half,
        "episode_index": episode,
        "task": ["lift"] * len(run.t),
    }
    table = arrow.table(columns)
    schema = table.schema
    for name in ("action", "observation.state"):
        place = schema.get_field_index(name)
        field = schema.field(place).with_metadata({"unit": "deg"})
        schema = schema.set(place, field)
    parquet.write_table(table.cast(schema), path)


def franka_ros2(path: Path, run: Measurements) -> None:
    """A state of several parts, with the joints' names beside each."""
    seconds, nanoseconds = _two_parts(run)
    names = [[joint] * len(run.t) for joint in JOINTS]
    parts = ("measured_joint_state", "desired_joint_state")
    fields = ("position", "velocity", "effort")
    head = ["header.stamp.sec", "header.stamp.nanosec"]
    head += _numbered(*(f"{parts[0]}.{x}[{{}}]" for x in ("name", *fields)))
    head += _numbered(f"{parts[1]}.position[{{}}]")
    blocks = _blocks(run.q, run.dq, run.tau, run.q + 1e-4)
    _write(path, head, [seconds, nanoseconds, *names, *blocks])


def bam(path: Path, run: Measurements, word: str = "torque") -> None:
    """A list of objects beside what was recorded, of two servos in lists."""
    entries = [
        {"timestamp": t, "position": q, "speed": dq, word: tau, "torque_enable": True}
        for t, q, dq, tau in zip(
            *(x.tolist() for x in (run.t, run.q, run.dq, run.tau)), strict=True
        )
    ]
    content = {"mass": 0.5, "kp": 32, "motor": "sts3215", "entries": entries}
    path.write_text(json.dumps(content))


def bam_load(path: Path, run: Measurements) -> None:
    bam(path, run, "load")


def xarm(path: Path, run: Measurements) -> None:
    head = ["timestamp", *_numbered("servo_angle_{}", "joints_torque_{}")]
    _write(path, head, [run.t, *_blocks(np.degrees(run.q), run.tau)])


def zero_based(path: Path, run: Measurements) -> None:
    head = ["t", *_numbered("q{}", "tau{}")]
    _write(path, head, [run.t, *_blocks(run.q, run.tau)])


def iso(path: Path, run: Measurements) -> None:
    begin = datetime.datetime(2025, 5, 1, 12)
    stamps = [
        (begin + datetime.timedelta(seconds=float(t))).isoformat(" ", "milliseconds")
        for t in run.t
    ]
    head = ["time", "q1", "q2", "tau1", "tau2"]
    _write(path, head, [stamps, *_blocks(run.q, run.tau)])


def lists(path: Path, run: Measurements) -> None:
    """As pandas writes cells of arrays."""
    cells = [
        [f'"[{row[0]:.10g}, {row[1]:.10g}]"' for row in block]
        for block in (run.q, run.dq, run.tau)
    ]
    names = ["\"['joint_1', 'joint_2']\""] * len(run.t)
    head = ["time", "name", "position", "velocity", "effort"]
    _write(path, head, [run.t, names, *cells])


def decimal_comma(path: Path, run: Measurements) -> None:
    """As a German spreadsheet writes it, with a row of units."""
    rows = ["t;q1;q2;tau1;tau2", "s;deg;deg;Nm;Nm"]
    for k, t in enumerate(run.t):
        cells = [t, *np.degrees(run.q[k]), *run.tau[k]]
        rows.append(";".join(f"{x:.8g}".replace(".", ",") for x in cells))
    path.write_text("\n".join(rows) + "\n")


def commented(path: Path, run: Measurements) -> None:
    """As numpy.savetxt writes a header."""
    head = "# " + " ".join(["t", *_numbered("q_{}", "dq_{}", "tau_{}")])
    values = np.column_stack([run.t, run.q, run.dq, run.tau])
    np.savetxt(path, values, "%.10g", header=head[2:])


def _two_parts(run: Measurements) -> tuple[list[str], list[str]]:
    """Stamps as seconds and nanoseconds."""
    whole = [START * 10**9 + round(1e9 * t) for t in run.t]
    return [str(x // 10**9) for x in whole], [str(x % 10**9) for x in whole]


#: What writes each sample.
SAMPLES: dict[str, Callable[[Path, Measurements], None]] = {
    "rtde.csv": rtde,
    "rtde_torque.csv": rtde_torque,
    "rtde_controller.csv": rtde_controller,
    "rostopic.csv": rostopic,
    "ros2_echo.csv": ros2_echo,
    "bagpy.csv": bagpy,
    "flattened.csv": flattened,
    "mujoco.csv": mujoco,
    "franka.csv": franka,
    "kuka_rsi.csv": kuka_rsi,
    "kuka_rsi_torque.csv": kuka_rsi_torque,
    "kuka_variables.csv": kuka_variables,
    "abb_rapid.csv": abb_rapid,
    "franka_old.csv": franka_old,
    "pyfri.csv": pyfri,
    "kortex.csv": kortex,
    "plotjuggler.csv": plotjuggler,
    "lerobot.parquet": lerobot,
    "lerobot_current.parquet": lerobot_current,
    "franka_ros2.csv": franka_ros2,
    "bam.json": bam,
    "bam_load.json": bam_load,
    "xarm.csv": xarm,
    "zero_based.csv": zero_based,
    "iso.csv": iso,
    "lists.csv": lists,
    "decimal_comma.csv": decimal_comma,
    "commented.csv": commented,
}

#: The folder of samples that were asked for; it goes with the process.
FOLDER = tempfile.TemporaryDirectory()


@cache
def sample_file(name: str) -> Path:
    """A sample as a file, which is written once."""
    path = Path(FOLDER.name) / name
    SAMPLES[name](path, sample_run())
    return path
