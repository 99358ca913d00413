"""One small log of a two-joint arm as each logger writes it.

The same numbers in all of them, so that a test can compare what is read.
"""

import datetime
import json
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from small_runs import small_run

from sdp_vs_penalty import Measurements, load_problem

#: When the logs with stamps of the day begin [s since 1970].
START = 1_740_000_000
JOINTS = ("joint_1", "joint_2")


@cache
def sample_run():
    """Eight seconds of the two-link arm at 50 Hz, of five decimals."""
    run = small_run(load_problem("two_link"), seconds=8.0, rate=50.0)
    q, dq, tau = (np.round(x, 5) for x in (run.q, run.dq, run.tau))
    return Measurements(np.round(run.t, 6), q, tau, dq)


def _write(path, head, columns, mark=","):
    """Columns of texts or numbers as one text table."""
    rows = zip(*(map(_cell, column) for column in columns), strict=True)
    lines = [] if head is None else [mark.join(head)]
    path.write_text("\n".join([*lines, *map(mark.join, rows)]) + "\n")


def _cell(x):
    return x if isinstance(x, str) else f"{x:.10g}"


def _numbered(*patterns):
    """Names by patterns like "q_{}", counted from 0."""
    return [pattern.format(k) for pattern in patterns for k in range(2)]


def _blocks(*blocks):
    return [column for block in blocks for column in block.T]


@dataclass(frozen=True)
class Columns:
    """A log of a clock and a column a joint."""

    #: The clock's name, its units a second, and where it starts.
    clock: tuple[str, float, float]
    #: The columns' names, numbered by {}, and what they hold.
    names: dict[str, str]
    #: The number of the first joint.
    first: int = 0
    #: The separator.
    mark: str = ","
    #: The name of a column of ones behind the clock.
    ones: str = ""

    def __call__(self, path, run):
        """Write the run."""
        degrees = np.degrees(run.q)
        held = {
            "q": run.q,
            "dq": run.dq,
            "tau": run.tau,
            "q asked": run.q + 1e-4,
            "degrees": degrees,
            "degrees asked": degrees + 0.01,
            "degrees from 0": degrees % 360.0,
            "turns": degrees / 360.0,
            "turns/s": np.degrees(run.dq) / 360.0,
            "degrees/s": np.degrees(run.dq),
            "external tau": 0.1 * run.tau,
            "current": 0.3 * run.tau,
        }
        name, rate, start = self.clock
        numbers = range(self.first, self.first + 2)
        head = [pattern.format(k) for pattern in self.names for k in numbers]
        ones = [np.ones(len(run.t))] if self.ones else []
        blocks = _blocks(*(held[what] for what in self.names.values()))
        head = [name, *([self.ones] if self.ones else []), *head]
        _write(path, head, [start + rate * run.t, *ones, *blocks], self.mark)


SECONDS = ("time", 1.0, 0.0)
RTDE = ("timestamp", 1.0, 1234.5)
KUKA = ("IPOC", 1e3, 0.0)
_RTDE = {"actual_q_{}": "q", "actual_qd_{}": "dq"}
_FRANKA = {"q[{}]": "q", "q_d[{}]": "q asked", "dq[{}]": "dq", "tau_J[{}]": "tau"}
TABLES = {
    "rtde": Columns(
        RTDE, {**_RTDE, "actual_current_{}": "tau", "target_q_{}": "q asked"}, mark=" "
    ),
    # As the controller makes torques of currents.
    "rtde_torque": Columns(
        RTDE, {**_RTDE, "actual_current_as_torque_{}": "tau"}, mark=" "
    ),
    "rtde_controller": Columns(RTDE, {**_RTDE, "target_moment_{}": "tau"}, mark=" "),
    "mujoco": Columns(
        SECONDS, {"qpos_{}": "q", "qvel_{}": "dq", "qfrc_actuator_{}": "tau"}
    ),
    "franka": Columns(
        ("time", 1e3, 0.0),
        {f"state.{name}": what for name, what in _FRANKA.items()},
        ones="success_rate",
    ),
    "franka_old": Columns(
        ("duration", 1e3, 0.0),
        {**_FRANKA, "tau_ext_hat_filtered[{}]": "external tau"},
        mark=", ",
        ones=" success rate",
    ),
    "odrive": Columns(
        SECONDS,
        {
            "axis{}.pos_estimate": "turns",
            "axis{}.vel_estimate": "turns/s",
            "axis{}.torque_estimate": "tau",
        },
    ),
    "odrive_current": Columns(
        SECONDS,
        {
            "axis{}.encoder.pos_estimate": "turns",
            "axis{}.motor.current_control.Iq_measured": "tau",
        },
    ),
    # Currents in per cent.
    "kuka_rsi": Columns(
        KUKA,
        {"AIPos.A{}": "degrees", "ASPos.A{}": "degrees asked", "MACur.A{}": "tau"},
        first=1,
    ),
    "kuka_rsi_torque": Columns(
        KUKA, {"AIPos.A{}": "degrees", "$TORQUE_AXIS_ACT[{}]": "tau"}, first=1
    ),
    # By the names of the controller's variables.
    "kuka_variables": Columns(
        SECONDS, {"$AXIS_ACT.A{}": "degrees", "$TORQUE_AXIS_ACT[{}]": "tau"}, first=1
    ),
    "abb_rapid": Columns(SECONDS, {"rax_{}": "degrees", "torque_{}": "tau"}, first=1),
    "kortex": Columns(
        SECONDS,
        {
            "actuators[{}].position": "degrees from 0",
            "actuators[{}].velocity": "degrees/s",
            "actuators[{}].torque": "tau",
            "actuators[{}].current_motor": "current",
        },
    ),
    "cia402": Columns(
        ("timestamp", 1.0, 0.0),
        {"0x6064_{}": "q", "0x606C_{}": "dq", "0x6077_{}": "tau"},
        first=1,
    ),
    "xarm": Columns(
        ("timestamp", 1.0, 0.0),
        {"servo_angle_{}": "degrees", "joints_torque_{}": "tau"},
    ),
    "zero_based": Columns(("t", 1.0, 0.0), {"q{}": "q", "tau{}": "tau"}),
}


def _reversed(run):
    """Names and numbers of joints that a driver lists from the last to the first."""
    names = [[joint] * len(run.t) for joint in JOINTS[::-1]]
    return [*names, *_blocks(*(x[:, ::-1] for x in (run.q, run.dq, run.tau)))]


def rostopic(path, run):
    fields = _numbered(*(f"field.{x}{{}}" for x in ("position", "velocity", "effort")))
    stamps = [str(START * 10**9 + round(1e9 * t)) for t in run.t]
    empty = [""] * len(run.t)
    head = ["%time", "field.header.frame_id", *_numbered("field.name{}"), *fields]
    _write(path, head, [stamps, empty, *_reversed(run)])


def ros2_echo(path, run):
    _write(path, None, [*_two_parts(run), [""] * len(run.t), *_reversed(run)])


def bagpy(path, run):
    seconds, nanoseconds = _two_parts(run)
    names = [[joint] * len(run.t) for joint in JOINTS]
    head = ["Time", "header.seq", "header.stamp.secs", "header.stamp.nsecs"]
    head += _numbered("name_{}", "position_{}", "velocity_{}", "effort_{}")
    late = [f"{START + t + 0.001:.4f}" for t in run.t]
    blocks = _blocks(run.q, run.dq, run.tau)
    count = list(range(len(run.t)))
    _write(path, head, [late, count, seconds, nanoseconds, *names, *blocks])


def flattened(path, run):
    seconds, nanoseconds = _two_parts(run)
    fields = [f"{joint}_{x}" for x in ("position", "effort") for joint in JOINTS]
    head = ["header.stamp.sec", "header.stamp.nanosec", *fields]
    _write(path, head, [seconds, nanoseconds, *_blocks(run.q, run.tau)])


def plotjuggler(path, run):
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


def pyfri(path, run):
    """Measured and interpolated positions, measured and external torques."""
    seconds, nanoseconds = _two_parts(run)
    head = ["index", "time", "record_time_nsec", "tsec", "tnsec"]
    head += [f"{word}{k}" for word in ("mp", "ip", "mt", "et") for k in (1, 2)]
    count = [str(k) for k in range(len(run.t))]
    blocks = _blocks(run.q, run.q + 1e-4, run.tau, 0.1 * run.tau)
    stamps = [str(START * 10**9 + round(1e9 * t) + 1000) for t in run.t]
    columns = [count, run.t, stamps, seconds, nanoseconds, *blocks]
    _write(path, [*head, "dt"], [*columns, np.full(len(run.t), 0.02)])


def lerobot_current(path, run):
    """As :func:`lerobot`, with the currents of the motors."""
    lerobot(path, run, "current")


def lerobot(path, run, word="effort"):
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


def franka_ros2(path, run):
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


def bam(path, run, word="torque"):
    """A list of objects beside what was recorded, of two servos in lists."""
    entries = [
        {"timestamp": t, "position": q, "speed": dq, word: tau, "torque_enable": True}
        for t, q, dq, tau in zip(
            *(x.tolist() for x in (run.t, run.q, run.dq, run.tau)), strict=True
        )
    ]
    content = {"mass": 0.5, "kp": 32, "motor": "sts3215", "entries": entries}
    path.write_text(json.dumps(content))


def bam_load(path, run):
    bam(path, run, "load")


def iso(path, run):
    begin = datetime.datetime(2025, 5, 1, 12)
    stamps = [
        (begin + datetime.timedelta(seconds=float(t))).isoformat(" ", "milliseconds")
        for t in run.t
    ]
    head = ["time", "q1", "q2", "tau1", "tau2"]
    _write(path, head, [stamps, *_blocks(run.q, run.tau)])


def lists(path, run):
    """As pandas writes cells of arrays."""
    cells = [
        [f'"[{row[0]:.10g}, {row[1]:.10g}]"' for row in block]
        for block in (run.q, run.dq, run.tau)
    ]
    names = ["\"['joint_1', 'joint_2']\""] * len(run.t)
    head = ["time", "name", "position", "velocity", "effort"]
    _write(path, head, [run.t, names, *cells])


def decimal_comma(path, run):
    """As a German spreadsheet writes it, with a row of units."""
    rows = ["t;q1;q2;tau1;tau2", "s;deg;deg;Nm;Nm"]
    for k, t in enumerate(run.t):
        cells = [t, *np.degrees(run.q[k]), *run.tau[k]]
        rows.append(";".join(f"{x:.8g}".replace(".", ",") for x in cells))
    path.write_text("\n".join(rows) + "\n")


def commented(path, run):
    """As numpy.savetxt writes a header."""
    head = "# " + " ".join(["t", *_numbered("q_{}", "dq_{}", "tau_{}")])
    values = np.column_stack([run.t, run.q, run.dq, run.tau])
    np.savetxt(path, values, "%.10g", header=head[2:])


def _two_parts(run):
    """Stamps as seconds and nanoseconds."""
    whole = [START * 10**9 + round(1e9 * t) for t in run.t]
    return [str(x // 10**9) for x in whole], [str(x % 10**9) for x in whole]


#: What writes each sample.
SAMPLES = {
    **{f"{name}.csv": table for name, table in TABLES.items()},
    "rostopic.csv": rostopic,
    "ros2_echo.csv": ros2_echo,
    "bagpy.csv": bagpy,
    "flattened.csv": flattened,
    "pyfri.csv": pyfri,
    "plotjuggler.csv": plotjuggler,
    "lerobot.parquet": lerobot,
    "lerobot_current.parquet": lerobot_current,
    "franka_ros2.csv": franka_ros2,
    "bam.json": bam,
    "bam_load.json": bam_load,
    "iso.csv": iso,
    "lists.csv": lists,
    "decimal_comma.csv": decimal_comma,
    "commented.csv": commented,
}

#: The folder of samples that were asked for; it goes with the process.
FOLDER = tempfile.TemporaryDirectory()


@cache
def sample_file(name):
    """A sample as a file, which is written once."""
    path = Path(FOLDER.name) / name
    SAMPLES[name](path, sample_run())
    return path
