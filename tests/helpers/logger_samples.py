"""One small log of a two-joint arm as each logger writes it.

The same numbers in all of them, so that a test can compare what is read.
"""

import datetime
import json
import tempfile
from functools import cache, partial
from pathlib import Path

import numpy as np
from small_runs import small_run
from written_logs import log

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


@cache
def held():
    """What the columns of tables hold."""
    run = sample_run()
    ones = np.ones(len(run.t))
    degrees, stamps = (
        np.degrees(run.q),
        START * 10**9 + np.round(1e9 * run.t).astype(int),
    )
    begin = datetime.datetime(2025, 5, 1, 12)
    days = [begin + datetime.timedelta(seconds=float(t)) for t in run.t]
    names = np.tile(JOINTS, (len(run.t), 1))
    blocks = {"q": run.q, "dq": run.dq, "tau": run.tau, "names": names}
    return {
        **blocks,
        # Of joints that a driver lists from the last to the first.
        **{f"turned {name}": block[:, ::-1] for name, block in blocks.items()},
        # As pandas writes cells of arrays.
        **{f"listed {name}": listed(block) for name, block in blocks.items()},
        "t": run.t,
        "ms": 1e3 * run.t,
        "later": 1234.5 + run.t,
        "late": np.array([f"{START + t + 0.001:.4f}" for t in run.t]),
        "ns": stamps.astype(str),
        "late ns": (stamps + 1000).astype(str),
        "seconds": (stamps // 10**9).astype(str),
        "nanoseconds": (stamps % 10**9).astype(str),
        "iso": np.array([day.isoformat(" ", "milliseconds") for day in days]),
        "count": np.arange(len(run.t)),
        "ones": ones,
        "step": 0.02 * ones,
        "empty": np.full(len(run.t), ""),
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


def listed(block):
    """Rows of a block as lists."""
    texts = [
        [f"'{x}'" if isinstance(x, str) else f"{x:.10g}" for x in row] for row in block
    ]
    return np.array(['"[' + ", ".join(row) + ']"' for row in texts])


#: Columns of tables, as written_logs says them.
_STAMP = "seconds=header.stamp.sec; nanoseconds=header.stamp.nanosec"
_RTDE = "later=timestamp; q=actual_q_{z}; dq=actual_qd_{z}"
_STATE = "measured_joint_state"
_SPACED = dict.fromkeys(("rtde", "rtde_torque", "rtde_controller"), " ")
SEPARATORS = {**_SPACED, "franka_old": ", "}
TABLES = {
    "rtde": f"{_RTDE}; tau=actual_current_{{z}}; q asked=target_q_{{z}}",
    # As the controller makes torques of currents.
    "rtde_torque": f"{_RTDE}; tau=actual_current_as_torque_{{z}}",
    "rtde_controller": f"{_RTDE}; tau=target_moment_{{z}}",
    "mujoco": "t=time; q=qpos_{z}; dq=qvel_{z}; tau=qfrc_actuator_{z}",
    "franka": "ms=time; ones=success_rate; q=state.q[{z}]; q asked=state.q_d[{z}];"
    " dq=state.dq[{z}]; tau=state.tau_J[{z}]",
    "franka_old": "ms=duration; ones= success rate; q=q[{z}]; q asked=q_d[{z}];"
    " dq=dq[{z}]; tau=tau_J[{z}]; external tau=tau_ext_hat_filtered[{z}]",
    "odrive": "t=time; turns=axis{z}.pos_estimate; turns/s=axis{z}.vel_estimate;"
    " tau=axis{z}.torque_estimate",
    "moteus": "t=timestamp; turns={}.position; turns/s={}.velocity; tau={}.torque;"
    " current={}.q_current",
    "odrive_current": "t=time; turns=axis{z}.encoder.pos_estimate;"
    " tau=axis{z}.motor.current_control.Iq_measured",
    # Currents in per cent.
    "kuka_rsi": "ms=IPOC; degrees=AIPos.A{}; degrees asked=ASPos.A{}; tau=MACur.A{}",
    "kuka_rsi_torque": "ms=IPOC; degrees=AIPos.A{}; tau=$TORQUE_AXIS_ACT[{}]",
    # By the names of the controller's variables.
    "kuka_variables": "t=time; degrees=$AXIS_ACT.A{}; tau=$TORQUE_AXIS_ACT[{}]",
    "abb_rapid": "t=time; degrees=rax_{}; tau=torque_{}",
    "abb_test_signals": "t=Time [s]; q=resolver_angle axis {}; dq=speed axis {};"
    " tau=torque_ref axis {}; ones=dig_input1",
    "kortex": "t=time; degrees from 0=actuators[{z}].position;"
    " degrees/s=actuators[{z}].velocity; tau=actuators[{z}].torque;"
    " current=actuators[{z}].current_motor",
    "cia402": "t=timestamp; q=0x6064_{}; dq=0x606C_{}; tau=0x6077_{}",
    "xarm": "t=timestamp; degrees=servo_angle_{z}; tau=joints_torque_{z}",
    "zero_based": "t=t; q=q{z}; tau=tau{z}",
    "rostopic": "ns=%time; empty=field.header.frame_id; turned names=field.name{z};"
    " turned q=field.position{z}; turned dq=field.velocity{z}; turned tau=field.effort{z}",
    "bagpy": "late=Time; count=header.seq; seconds=header.stamp.secs;"
    " nanoseconds=header.stamp.nsecs; names=name_{z}; q=position_{z}; dq=velocity_{z};"
    " tau=effort_{z}",
    "flattened": f"{_STAMP}; q=joint_{{}}_position; tau=joint_{{}}_effort",
    # Measured and interpolated positions, measured and external torques.
    "pyfri": "count=index; t=time; late ns=record_time_nsec; seconds=tsec;"
    " nanoseconds=tnsec; q=mp{}; q asked=ip{}; tau=mt{}; external tau=et{}; step=dt",
    # A state of several parts, with the joints' names beside each.
    "franka_ros2": f"{_STAMP}; names={_STATE}.name[{{z}}]; q={_STATE}.position[{{z}}];"
    f" dq={_STATE}.velocity[{{z}}]; tau={_STATE}.effort[{{z}}];"
    " q asked=desired_joint_state.position[{z}]",
    "iso": "iso=time; q=q{}; tau=tau{}",
    "lists": "t=time; listed names=name; listed q=position; listed dq=velocity;"
    " listed tau=effort",
}


def table(path, run, row, mark=",", **how):
    """A log as TABLES has it."""
    log(path, row, mark=mark, held=held(), **{"cell": "{:.10g}".format, **how})


def ros2_echo(path, run):
    row = f"{_STAMP}; empty=frame; turned names={{}}; turned q={{}}; turned dq={{}}"
    table(path, run, f"{row}; turned tau={{}}", head=[])


def decimal_comma(path, run):
    """As a German spreadsheet writes it, with a row of units."""
    head = ["t;q1;q2;tau1;tau2", "s;deg;deg;Nm;Nm"]
    row, cell = "t=t; degrees=q{}; tau=tau{}", "{:.8g}".format
    table(path, run, row, ";", head=head, decimal=",", cell=cell)


def commented(path, run):
    """As numpy.savetxt writes a header."""
    table(path, run, "t=# t; q=q_{z}; dq=dq_{z}; tau=tau_{z}", " ")


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


#: What writes each sample.
SAMPLES = {
    **{
        f"{name}.csv": partial(table, row=row, mark=SEPARATORS.get(name, ","))
        for name, row in TABLES.items()
    },
    "ros2_echo.csv": ros2_echo,
    "plotjuggler.csv": plotjuggler,
    "lerobot.parquet": lerobot,
    "lerobot_current.parquet": lerobot_current,
    "bam.json": bam,
    "bam_load.json": bam_load,
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
