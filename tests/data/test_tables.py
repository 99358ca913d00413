"""Text tables as other programs and people write them: the same motion comes out of every
one, or one sentence says what is missing and how to name it.

A row is a file: what its columns hold, and their names (helpers/written_logs.py).
"""

import numpy as np
import pytest
from recorded import refusal
from written_logs import HELD, JOINTS, SORTED, Q, T, log, read, same

from sdp_vs_penalty import convert

READ = """
t=t; q=q{z}; dq=dq{z}; tau=tau{z}
t=TIME; q=POS_{}; dq=VEL_{}; tau=TORQUE_{}
t=time; q=q[{z}]; dq=qd[{z}]; tau=tau[{z}]
t=time; q=q({}); dq=qd({}); tau=tau({})
t=timestamp; q=position.{z}; dq=velocity.{z}; tau=effort.{z}
t=__time; q=joint_states/position[{z}]; dq=js/velocity[{z}]; tau=js/effort[{z}]
t=t; q=a/position[{z}]; dq=a/vel[{z}]; tau=efforts/effort[{z}]
t=time; q=q{}_pos; dq=q{}_vel; tau=q{}_torque
t=time; q=theta{}; dq=theta_dot{}; tau=torque{}
t=Time; q=Joint {z} Position; dq=Joint {z} Speed; tau=Joint {z} Torque
t=t; q=ur10/q_{z}; dq=ur10/qd_{z}; tau=ur10/tau_{z}
t=time; q=qpos.{z}; dq=qvel.{z}; tau=qfrc_actuator.{z}
t=time; q=data.qpos[{z}]; dq=data.qvel[{z}]; tau=data.qfrc_actuator[{z}]
t=time; q=qpos_{z}; dq=qvel_{z}; tau=actuator_force_{z}
t=time; q=th_{}; dq=w_{}; tau=tq_{}
t=time; q=AxisPos_A{}; dq=AxisVel_A{}; tau=AxisTor_A{}
t=time; q=JPOS_{}; dq=JVEL_{}; tau=JTRQ_{}
t=time; q=phi{}; dq=phi_dot{}; tau=moment{}
t=time; q=msrJntPos{}; dq=msrJntVel{}; tau=msrJntTrq{}
t=time; q=servo{}.pos; dq=servo{}.spd; tau=servo{}.trq
t=time; q={s}_position; tau={s}_effort
t=time; q=position/{s}; tau=effort/{s}
t=time; q={s}.pos; tau={s}.torque
t=time; q=left_{s}/position; tau=left_{s}/effort
t=time; q=/arm_2/joint_states/{s}/position; tau=/arm_2/joint_states/{s}/effort
t=time; q=q_{s}; tau=tau_{s}
t=time; q={j}_pos; tau={j}_frc
t=time; q=jointpos_{j}; tau=jointactuatorfrc_{j}
t=time; q={j}_jointpos; tau={j}_actuatorfrc
t=time; q=Model/Arm/q{}/Out1; dq=Model/Arm/dq{}/Out1; tau=Model/Arm/tau{}/Out1
ms=t_ms; deg=q{}_deg; deg/s=dq{}_deg_s; mNm=tau{}_mNm
ms=Time (ms); deg=q{} (deg); deg/s=dq{} (deg/s); mNm=tau{} (mNm)
ms=time [ms]; deg=pos_deg[{}]; deg/s=vel_dps[{}]; mNm=tau_mNm[{}]
ms=time_ms; deg=posDeg{}; deg/s=velDeg{}; mNm=torque_mNm_{}
ms=time/ms; deg=q_{} in deg; mNm=tau_{} in mNm
t=t; q=q{}; mNm=tau{} (mN.m)
t=t; q=q{}; mNm=tau{} (mN*m)
t=t; q=q{}; mNm=tau{} (mN m)
t=t; q=q{}; mNm=tau{} (N mm)
t=t; q=q{}; tau=tau{} [Newton-meter]
t=t; q=q{}; foot-pounds=tau_{}_ftlb
t=t; q=q{}; foot-pounds=tau{}_ft_lbs
t=t; q=q{}; foot-pounds=tau{} [lb.ft]
t=t; q=q{}; foot-pounds=trq{}_footpounds
t=t; q=q{}; ounces=tau{} (oz-in)
t=t; q=q{}; ounces=tau{} (ozf in)
t=t; q=q{}; ounces=tau{} (oz*in)
t=time; deg=J{}(deg); tau=J{}(Nm)
t=time; deg=A{} [°]; tau=A{} [N m]
t=time; deg=feedback_joint_{}_deg; tau=motor_{} (N.m)
t=Zeit [s]; deg=Winkel{} [Grad]; tau=Moment{} [Nm]
t=temps (s); deg=angle{} (degrés); tau=couple{} (N.m)
t=tiempo (s); deg=posición {} (grados); tau=par {} (N·m)
t=tempo (s); deg=posizione {} (gradi); tau=coppia {} (Nm)
t=tempo (s); deg=posição {} (graus); tau=torque {} (Nm)
t=tijd; deg=positie{} (graden); tau=koppel{}
t=idő [s]; deg=szög {} [fok]; tau=nyomaték {} [Nm]
t=t/s; deg=phi_{}/deg; tau=M_{}/Nm
t=t; q=q{}; dq=q̇{}; tau=τ{}
t=czas; deg=pozycja{} [stopnie]; tau=moment{}
t=Время (с); deg=Угол {} (град); tau=Момент {} (Н·м)
t=时间(s); deg=关节{}角度(度); tau=关节{}力矩(Nm)
t=时间戳(秒); deg=关节位置{}(°); tau=关节扭矩{}
t=時刻[s]; deg=関節角度{}[deg]; tau=関節トルク{}[Nm]
t=시간(s); deg=관절{} 각도(deg); tau=관절{} 토크(Nm)
t=Zeit; q=Istposition A{}; tau=Istmoment A{}
t=jikan; q=kansetsu{}_kakudo; dq=kansetsu{}_sokudo; tau=kansetsu{}_toruku
t=時間; q=関節角{}; tau=トルク{}
t=t; q=角度{}; tau=tau{}
t=t; q=关节角度{}; tau=tau{}
t=t; q=関節角度{}; tau=tau{}
t=t; q=각도{}; tau=tau{}
far=time; q=q_{}; tau=tau_{}
min=Time (min); q=q{}; tau=tau{}
h=Time (h); q=q{}; tau=tau{}
t=; q=q{}; tau=tau{}
min=minutes; q=pos{}; dq=vel{}; tau=trq{}
min=run_minutes; q=pos{}; dq=vel{}; tau=trq{}
ms=Laufzeit_ms; q=pos{}; dq=vel{}; tau=trq{}
h=gone [h]; q=pos{}; dq=vel{}; tau=trq{}
min=time_min; q=pos{}; dq=vel{}; tau=trq{}
epoch=header.stamp.sec; ns=header.stamp.nanosec; q=q_{}; tau=tau_{}
ns=stamp_ns; epoch=stamp_s; q=q_{}; tau=tau_{}
epoch=Time (s); ns=Time (ns); q=q_{}; tau=tau_{}
epoch=tv_sec; us of ns=tv_usec; q=q_{}; tau=tau_{}
ms of ns=time.msec; epoch=time.sec; q=q_{}; tau=tau_{}
epoch=stampSec; ns=stampNanoSec; q=q_{}; tau=tau_{}
epoch=sec_; ns=nanosec_; q=q_{}; tau=tau_{}
epoch=timestamp.seconds; ns=timestamp.nanos; q=q_{}; tau=tau_{}
epoch=/js/header/stamp/sec; ns=/js/header/stamp/nanosec; q=q_{}; tau=tau_{}
@%Y-%m-%dT%H:%M:%S.%f=time; q=q{}; tau=tau{}
@%Y-%m-%dT%H:%M:%S.%fZ=time; q=q{}; tau=tau{}
@%Y-%m-%dT%H:%M:%S.%f+02:00=time; q=q{}; tau=tau{}
@%Y-%m-%d %H:%M:%S.%f -0500=time; q=q{}; tau=tau{}
@%Y/%m/%d %H:%M:%S.%f=time; q=q{}; tau=tau{}
@%d.%m.%Y %H:%M:%S.%f=time; q=q{}; tau=tau{}
@%m/%d/%Y %I:%M:%S.%f %p=time; q=q{}; tau=tau{}
@%H:%M:%S.%f=time; q=q{}; tau=tau{}
@2024-05-01T12:00:{}+02=Time; q=q_{}; tau=tau_{}
@2024-05-01T12:00:{} CEST=datum; q=q_{}; tau=tau_{}
@2024-05-01 12:00:{} GMT=datetime; q=q_{}; tau=tau_{}
@2024-05-01T12:00:{}+02:00[Europe/Berlin]=; q=q_{}; tau=tau_{}
@20240501T1200{}=recorded; q=q_{}; tau=tau_{}
@01-May-2024 12:00:{}=; q=q_{}; tau=tau_{}
@Wed May 01 12:00:{} 2024=recorded; q=q_{}; tau=tau_{}
@2024/05/01/12:00:{}=datum; q=q_{}; tau=tau_{}
@00:{}=recorded; q=q_{}; tau=tau_{}
@0 days 00:00:{}=Time; q=q_{}; tau=tau_{}
day's second=Time; ms of s=ms; q=q{}; tau=tau{}
day's second=Time; ms of s=Millisecond; q=q{}; tau=tau{}
text=Date; day's second=Time; ms of s=msec; q=q{}; tau=tau{}
t=time; 50q={j}_motor_position; q={j}_position; tau={j}_effort
t=time; 50q=theta_{}; q=q_{}; tau/2=tau_m_{}; tau=tau_j_{}
t=time; q=q_m_{}; q+1=q_d_{}; tau=tau_{}
t=time; 50q=theta_m{}; q=q_{}; tau=tau_{}
t=time; q+1=j{}; q=position{}; tau=trq{}
t=time; deg=P{} (deg); deg/s=V{} (deg/s); tau=M{} (N.m)
t=time; q=X{} (RAD); dq=Xd{} (rad/s); mNm=T{} [mN*m]
t=elapsed; q=q{}; tau=trq{}
t=time; q=theta{}; tau=T{} [N*m]
ms=ms; q=pos{}; tau=trq{}
t=s; q=pos{}; dq=vel{}; tau=trq{}
t=min; q=pos{}; dq=vel{}; tau=trq{}
t=q_min; q=pos{}; dq=vel{}; tau=trq{}
0=delay_ms; q=pos{}; dq=vel{}; tau=trq{}
t=Laufzeit in s; q=A{} Lage (rad); tau=A{} Moment (Nm)
t=temps; q=pos_mes{}; q+1=pos_cons{}; tau=couple{}
ms=IPOC; deg=AIPos_A{}; q=MACur_A{}; tau=Torque_A{}
t=TICK_S; deg=ANG_DEG_J{}; mNm=TORQUE_MNM_J{}
deg=q_deg_{}; deg/s=dq_deg_s_{}; tau=tau_{}
t=time; deg=A{}_S.r2521: LR Position [deg]; tau=A{}_S.r80: Torque [Nm]
ms=tick; q=q{}; dq=dq{}; tau=tau{}
@%H:%M:%S;%f=Time; q=J{}.ActualPosition; tau=J{}.TorqueReference
t=time; q=axis {} position_rad; tau=axis {} torque_ref_Nm
t=when; q=q{}; tau=tau{}
t=time; q=theta{}; tau=G{} [N*m]
t=time; deg={s} [deg]; tau={s} [Nm]
t=time; q=pos{}; tau=tauRaw{}
t=time; q={s}_pos; tau={s}_load
t=tm; q=feedBack.joints[{z}]; q+1=planned.joints[{z}]; tau=MotorTorque[{z}]
t=time; q+1=q_d/ActualPosition[{z}]; q=ActualPosition[{z}]; tau=ActualTorque[{z}]
"""  # noqa: RUF001


@pytest.mark.parametrize("row", READ.strip().splitlines())
def test_the_same_motion_comes_out_of_every_table(row, tmp_path):
    same(read(log(tmp_path / "run.csv", row))[0], row)


OURS = "t=t; q=q{}; tau=tau{}"
SEMICOLONS = "ms=t [ms]; deg=q{} [deg]; mNm=tau{} [mNm]"
#: Ways of writing numbers.
NUMBERS = {
    "blanks": lambda x: f"{x:,.6f}".replace(",", " ").replace(".", ","),
    "narrow blanks": lambda x: f"{x:,.6f}".replace(",", "\u202f").replace(".", ","),
    "hard blanks": lambda x: f"{x:,.6f}".replace(",", "\u00a0").replace(".", ","),
    "apostrophes": lambda x: f"{x:,.6f}".replace(",", "'"),
    "minus signs": lambda x: f"{x:.6f}".replace("-", "\u2212"),
    "Fortran": lambda x: f"{x:.9E}".replace("E", "D"),
    "German": lambda x: f"{x:,.6f}".translate(str.maketrans(",.", ".,")),
    "English": lambda x: f"{x:,.6f}",
}
UNITS = "{0},deg,deg,deg,Nm,Nm,Nm"
#: Rows above the values.
HEADS = [
    [UNITS.format("s"), "t,q1,q2,q3,tau1,tau2,tau3"],
    ["t,q1,q2,q3,tau1,tau2,tau3", UNITS.format("")],
    ["time,position [deg],,,torque,,", ",1,2,3,1,2,3"],
    [",position,,,torque,,", "t [s],1 [deg],2 [deg],3 [deg],1,2,3"],
    ["Time,Position [deg],,,Torque [Nm],,", "[s],J1,J2,J3,J1,J2,J3"],
    [
        "Zeit,Achse 1,Achse 2,Achse 3,Achse 1,Achse 2,Achse 3",
        ",Position,Position,Position,Moment,Moment,Moment",
        "s,Grad,Grad,Grad,Nm,Nm,Nm",
    ],
    [
        ",Position,,,Torque,,",
        "Time,J1,J2,J3,J1,J2,J3",
        "[s],[deg],[deg],[deg],[Nm],[Nm],[Nm]",
    ],
    [
        "File version,1.0,,,,,",
        "Rate,100,Hz,,,,",
        "t,q1_deg,q2_deg,q3_deg,tau1,tau2,tau3",
    ],
    ["t,q,q,q,tau,tau,tau", ",0 [deg],1 [deg],2 [deg],0,1,2"],
]
WRITTEN = {
    **{
        f"mark {mark!r}": (OURS, {"mark": mark})
        for mark in (";", "\t", " ", "  ", "^", ":")
    },
    **{
        f"comma, mark {mark!r}": (
            OURS.replace("t=t", "t=Zeit"),
            {"mark": mark, "decimal": ","},
        )
        for mark in (";", "\t", "|")
    },
    **{
        f"above {above[0]!r}": (OURS, {"above": above})
        for above in (
            ["%% logged by matlab", "%% units SI"],
            ["Robot log export", "Date: 2026-01-02", ""],
            ["sep=,"],
            ["# made by hand, on Monday"],
            ["", "# of the arm"],
            ["", "Log of the arm", ""],
            [",,"],
        )
    },
    **{
        f"head {k}, {letters}": (
            "t=; deg={}; tau={}",
            {"head": head, "encoding": letters},
        )
        for k, head in enumerate(HEADS)
        for letters in ("utf-8-sig", "utf-16", "utf-16-le", "utf-32")
    },
    **{
        f"numbers, {kind}": (
            SEMICOLONS,
            {"mark": "\t" if kind == "English" else ";", "cell": cell},
        )
        for kind, cell in NUMBERS.items()
    },
    **{
        f"quoted {ends!r}": (
            OURS,
            {
                "cell": '"{:.12g}"'.format,
                "head": ['"t","q1","q2","q3","tau1","tau2","tau3"'],
                "encoding": "utf-8-sig",
                "ends": ends,
            },
        )
        for ends in ("\n", "\r\n")
    },
    "names in a comment": (
        "t=; deg={}; tau={}",
        {
            "head": [
                "# time,q1,q2,q3,tau1,tau2,tau3",
                "[s],[deg],[deg],[deg],[N*m],[N*m],[N*m]",
            ]
        },
    ),
    "letters of axes": (
        "t=; deg={}; tau={}",
        {"head": ["time,S [deg],L [deg],U [deg],S [Nm],L [Nm],U [Nm]"]},
    ),
    "letters of joints": (
        "t=; q={}; tau={}",
        {"head": ["t,ang_a,ang_b,ang_c,trq_a,trq_b,trq_c"]},
    ),
    "titles of words": (
        "@%Y-%m-%d %H:%M:%S.%f=Date; q=Arm:J{}.ActPos; tau=Arm:J{}.ActTorque",
        {"above": ["Trend Export,X", "Period,100 Hz"]},
    ),
    **{
        f"units above, {line}": (
            "ms=t; deg=pos_{}; deg/s=vel_{}; mNm=trq_{}",
            {"above": [line]},
        )
        for line in (
            "# time in ms, positions in deg, velocities in deg/s, torques in mNm",
            "# units: ms deg deg/s mNm",
            "% t [ms]; position [deg]; velocity [deg/s]; torque [mNm]",
        )
    },
    "a rate of logging above": (
        "q=q{}; tau=tau{}",
        {"above": ["# logged at 100Hz", "# stopped at 14"]},
    ),
    "a remark below names and units": (
        "t=; deg={}; tau={}",
        {"head": ["Time,q1,q2,q3,M1,M2,M3", "s,deg,deg,deg,Nm,Nm,Nm", "run 3,,,,,,"]},
    ),
    "a rate above": ("q=q{}; tau=tau{}", {"above": ["# sample rate: 0.1 kHz"]}),
    "a rate alone above": ("q=q{}; tau=tau{}", {"above": ["# rate: 100"]}),
    "a step above": ("q=q{}; tau=tau{}", {"above": ["# arm 3 kg", "# dt = 10 ms"]}),
    "a step, its unit first": (
        "q=q{}; tau=tau{}",
        {"above": ["# cutoff freq: 40 Hz", "# sampling period [s]: 0.01"]},
    ),
    "a step without a word": ("q=q{}; tau=tau{}", {"above": ["Sampling [ms]: 10"]}),
    "a period above": ("q=q{}; tau=tau{}", {"above": ["Sampling time = 10 ms", ""]}),
    "gbk": ("t=时间; q=关节{}角度; tau=关节{}力矩", {"encoding": "gbk"}),
    "shift_jis": ("t=時刻; q=関節角度{}; tau=関節トルク{}", {"encoding": "shift_jis"}),
    "euc_kr": ("t=시간; q=관절{}각도; tau=관절{}토크", {"encoding": "euc_kr"}),
    "cp1251": ("t=Время; q=Угол{}; tau=Момент{}", {"encoding": "cp1251"}),
    "cp1252": ("t=t; deg=q{} [°]; tau=tau{}", {"encoding": "cp1252"}),
}


@pytest.mark.parametrize("case", WRITTEN)
def test_the_same_motion_comes_out_of_every_writing(case, tmp_path):
    row, how = WRITTEN[case]
    joints = None if case.startswith("head") else JOINTS
    run, _ = read(log(tmp_path / "run.csv", row, **how), joints)
    same(run, row, atol=2e-6)
    assert run.torque_unit == ""


@pytest.mark.parametrize("clock", ["Tick", "t"])
@pytest.mark.parametrize("has_velocities", [False, True])
def test_rows_that_were_lost_or_come_twice_are_told_by_what_counts_them(
    clock, has_velocities, tmp_path
):
    """By a counter, at the rate of the header or the velocities, or by a clock."""
    rows = np.delete(np.repeat(np.arange(len(T)), np.where(T == 0.5, 2, 1)), 100)
    held = {x: np.asarray(y)[rows] for x, y in {**HELD, "count": 1e2 * T}.items()}
    row = f"{'t=t' if clock == 't' else 'count=Tick'}; deg=q{{}} [deg]; tau=T{{}} [Nm]"
    row += "; deg/s=w{} [deg/s]" if has_velocities else ""
    above = [] if has_velocities else ["# dt = 10 ms"]
    run, said = read(log(tmp_path / "run.csv", row, above=above, held=held))
    np.testing.assert_allclose(run.t, np.delete(T, 99), atol=1e-9)
    np.testing.assert_allclose(run.q, np.delete(Q, 99, axis=0), atol=1e-9)
    assert "1 row like the one before, the stamp too: left out" in said
    assert ("t = Tick, which counts rows at 100 Hz" in said) is (clock == "Tick")


@pytest.mark.parametrize("cell", ["{:,.0f}", "{:.3f}"])
def test_a_block_has_a_decimal_mark_of_its_own(cell, tmp_path):
    """Of millidegrees with marks of thousands, or with points, beside decimal commas."""
    texts = np.vectorize(lambda x: cell.format(x).replace(",", "."))
    held = {**HELD, "mdeg": texts(1e3 * np.degrees(Q))}
    row = "t=t; mdeg=q{} [mdeg]; tau=tau{}"
    path = log(tmp_path / "run.csv", row, mark=";", decimal=",", held=held)
    same(read(path)[0], row, atol=2e-5)


def test_a_comma_is_decimal_where_it_is_in_another_column(tmp_path):
    """In one beside points each comma could separate thousands."""
    large, small = (
        np.char.replace(np.char.mod("%.3f", x), ".", ",") for x in (Q + 9, Q)
    )
    held = {**HELD, "large": np.column_stack([large[:, :2], small[:, 2]])}
    path = log(tmp_path / "run.csv", "t=t; q=q{}; large=tau{}", mark=";", held=held)
    np.testing.assert_allclose(read(path)[0].tau, Q + np.array([9, 9, 0]), atol=5e-4)


#: What is said beside the motion.
SAID = """
t=time; 50q=motor_position_{}; q=joint_position_{}; tau=joint_torque_{} -> (motor_position_1 to
t=time; 50q=motor_pos_{}; q=link_pos_{}; tau=torque_{} -> (motor_pos_1 to motor_pos_3) are not used
t=time; 50q=pos_motor_{}; q=pos_link_{}; tau=tau_{} -> (pos_motor_1 to pos_motor_3) are not used
t=time; 50q=q{}_motor; q=q{}_link; tau=tau{} -> (q1_motor to q3_motor) are not used
t=time; 50q=qm{}; q=ql{}; tau=tau{} -> (qm1 to qm3) are not used
t=time; 50q=q_m_{}; q=q_l_{}; tau=tau_{} -> (q_m_1 to q_m_3) are not used
t=time; 50q=theta_m_{}; q=theta_l_{}; tau=tau_{} -> (theta_m_1 to theta_m_3) are not used
t=time; q=joint_position_{}; tau=motor_torque_{} -> tau are the motors' torques
t=time; q=motor_position_{}; tau=motor_torque_{} -> q are the motors' positions
t=t; q=q{}; tau=torque_{} [%] -> whose size the file does not say
t=t; q=q{}; tau=torque_{} percent -> whose size the file does not say
t=t; q=q{}; tau=torque_{} [0.1%] -> whose size the file does not say
t=t; q=pos_{} [counts]; tau=torque_{} -> q is in counts, whose size
t=t; q=q{}; tau=torque_{} [st-furlong] -> tau is in 'st-furlong', a unit that is not known
t=time; deg=j{}; tau=trq{} -> q in deg, it reaches
t=time; q=j{}; tau=trq{} -> q in rad, it reaches
t=time; deg=AxisAct_A{}; tau=TorqueAct_A{} -> q in deg, it reaches
t=time; deg=robax_{}; tau=torque_{} -> q in deg, it reaches
q=q{}; dq=dq{}; tau=tau{} -> t = rows at 100 Hz, at which dq is the derivative of q
q=q{}; dq=dq{}; tau=tau{} -> --rate 100 --out
t=t; text=mode; q=q{}; tau=tau{}; text=extra -> not used: mode, extra
t=t; q=q{}; nan=dq{}; tau=tau{} -> dq is left out
hour=hour; minute=min; second=sec; q=pos{}; tau=trq{} -> the date is not read
day=date; hour=hour; minute=minute; second=second; q=pos{}; dq=vel{}; tau=trq{} -> the date is not read
0=YYYY; month=MM; day=DD; hour=hh; minute=mm; second=ss; q=pos{}; tau=trq{} -> the date is not read
0=Month; 0=Day; hour=Hour; minute=Minute; whole=Second; ms of s=Millisecond; q=q{}; tau=tau{} -> date
hour=stamp_h; minute=stamp_m; whole=stamp_s; us of s=stamp_us; q=pos{}; tau=trq{} -> the date is not read
hour=hour; minute=minute; whole=second; t=time; q=pos{}; dq=vel{}; tau=trq{} -> t = time
t=__time; q=/c/feedback/positions[{}]; tau=/c/feedback/effort[{}]; 50q=/c/output/positions[{}] -> puts
t=__time; q=/c/feedback/positions[{}]; tau=/c/feedback/effort[{}]; tau/2=/c/output/effort[{}] -> puts out
t=time; q=feedback/q[{}]; 50q=output/q[{}]; tau=output/effort[{}] -> output/q[1..3] is
"""


@pytest.mark.parametrize("case", SAID.strip().splitlines())
def test_what_is_said_beside_the_motion(case, tmp_path):
    row, words = case.split(" -> ")
    run, said = read(log(tmp_path / "run.csv", row))
    same(run, row)
    assert words in said


DATES = [
    ("days", "day"),
    ("datenum", "day"),
    ("julian", "day"),
    ("filetime", "100ns"),
    ("ticks", "100ns"),
    ("unix", "ms"),
]


@pytest.mark.parametrize(("kind", "unit"), DATES)
@pytest.mark.parametrize("mark", [",", ";"])
def test_clocks_that_count_from_a_date(kind, unit, mark, tmp_path):
    how = {
        "mark": mark,
        "decimal": "," if mark == ";" else ".",
        "cell": "{:.10f}".format,
    }
    path = log(tmp_path / "run.csv", f"{kind}=Timestamp; q=q_{{}}; tau=tau_{{}}", **how)
    run, said = read(path)
    assert abs(run.t - run.t[0] - T).max() < 1e-4
    assert abs(run.q - Q).max() < 1e-9
    assert f"t in {unit}, for it counts since" in said


#: What is refused, and words of the sentence.
REFUSED = """
t=time; q=left_q_{}; tau=left_tau_{}; q+1=right_q_{}; tau/2=right_tau_{} -> left_q_3 or right_q_1
t=time; q=left_q_{}; tau=left_tau_{}; q+1=right_q_{}; tau/2=right_tau_{} -> q*=left_q_*,tau*=left
t=time; 50q=primary_pos_{}; q=secondary_pos_{}; tau=torque_{} -> primary_pos_3 or secondary_pos_1
t=time; q=J{}; tau=T{} -> no column t or q or tau
t=time; q=J{}; tau=T{} -> --rename 't=time,q*=J*,tau*=T*'
ms=stamp (ms); q=Q{}; tau=M{} -> tau*=M*' --scale t=ms
t=time; q=P{}; dq=V{}; tau=M{} -> q*=P*,dq*=V*,tau*=M*
t=time; tau=M{}; q=P{}; dq=V{} -> q*=P*,dq*=V*,tau*=M*
t=time; q=X{}; dq=Xd{}; tau=u_actual.{} -> q*=X*,dq*=Xd*,tau*=u_actual.*
t=time; deg=th_{} [deg]; dq=w_{}; tau=F{} -> tau*=F*
t=time; deg=P{} in deg; tau=M{} -> --scale q=deg
unix=time; q=P{}; tau=M{} -> --scale t=ms
t=time; q={s}_pos; tau={s}_zork -> q1=turn_pos,q2=shoulder_pos,q3=elbow_pos,tau1=turn_zork
t=time; q={s}_pos -> q3=elbow_pos,tau=NAME
k=; q=q{}; tau=tau{} -> no column t
q=q{}; tau=tau{} -> --rate HZ
q=q{}; deg/s=dq{}; tau=tau{} -> --rate HZ
q={s}_position; tau={s}_effort -> --rate HZ --joints turn,shoulder,elbow
t=t; q=q{}; texts=tau{} -> column tau1 is never a number: 'off'
t=t; q=q{}; nan=tau{} -> column tau1 is never a number, in none of 150 rows: log it anew
t=t; q=q{} -> no column tau
t=t; q=q{} -> +TORQUES.csv
"""


@pytest.mark.parametrize("case", REFUSED.strip().splitlines())
def test_what_names_leave_open_is_refused_with_the_command(case, tmp_path):
    row, words = case.split(" -> ")
    refusal(lambda: read(log(tmp_path / "run.csv", row)), words)


FRAMES = [
    ("{}", "{}_joint"),
    ("{}_joint", "{}"),
    ("arm_{}_joint", "{}"),
    ("l_{}", "left_{}"),
    ("ur_{}_joint", "robot1_{}_motor"),
    ("{}", "{}"),
    ("{}", "LEFT-{}"),
]


@pytest.mark.parametrize(("robot", "named"), FRAMES)
@pytest.mark.parametrize("pattern", ["/joint_states/{}/{}", "{}_{}", "{}.{}"])
def test_joints_with_other_words_around_their_names_are_matched(
    pattern, robot, named, tmp_path
):
    joints = [named.format(JOINTS[k].capitalize()) for k in SORTED]
    heads = [pattern.format(j, x) for x in ("position", "effort") for j in joints]
    head = [",".join(["__time", *heads])]
    path = log(tmp_path / "run.csv", "t=t; q={s}; tau={s}", head=head)
    same(read(path, [robot.format(j) for j in JOINTS])[0])


def test_joints_of_other_names_stay_in_the_file_s_order_and_this_is_said(tmp_path):
    path = log(tmp_path / "run.csv", "t=time; q={j}_position; tau={j}_effort")
    run, said = read(path, ("hip", "knee", "toe"))
    same(run)
    assert "joints turn, shoulder, elbow in the file's order" in said


@pytest.mark.parametrize("joints", ["ABC", ("base", "shoulder", "elbow")])
def test_letters_and_words_tell_joints_apart(joints, tmp_path):
    names = [f"{joint} {x}" for x in ("angle", "torque") for joint in joints]
    path = log(tmp_path / "run.csv", OURS, head=[",".join(["time", *names])])
    same(read(path)[0])
    same(read(path, None)[0])


def test_units_of_columns_that_are_chosen_are_those_of_their_names(tmp_path):
    """They were dropped without a word. A stated factor replaces them."""
    path = log(tmp_path / "run.csv", "ms=clock [ms]; deg=A{} [deg]; mNm=B{} [mNm]")
    pairs = {"t": "clock [ms]"}
    for k in (1, 2, 3):
        pairs |= {f"q{k}": f"A{k} [deg]", f"tau{k}": f"B{k} [mNm]"}
    same(read(path, rename=pairs)[0])
    same(convert(path, rename=pairs, scale={"q": "deg", "t": "ms", "tau": "mNm"}))


def test_joints_in_brackets_are_no_units(tmp_path):
    path = log(tmp_path / "run.csv", "t=time; q=position[{j}]; tau=effort[{j}]")
    assert "is not known" not in read(path)[1]


def test_hours_minutes_and_seconds_that_are_three_clocks_are_no_time_of_day(tmp_path):
    """The same stamp in three units; the first hours and minutes are rounded to 0."""
    row = "h=t_hour; min=t_min; t=t_sec; q=q{}; tau=tau{}"
    path = log(tmp_path / "run.csv", row)
    assert "t = t_hour+t_min" not in read(path)[1]
    path = log(tmp_path / "run.csv", row, cell=lambda x: f"{2.5 * x:.1f}")
    refusal(lambda: read(path), "no whole numbers", "--rename t=NAME")


def test_without_a_header_the_robot_tells_the_number_of_joints(tmp_path):
    path = log(tmp_path / "run.csv", OURS, head=[])
    said = refusal(lambda: read(path), "where its columns are t, q and tau")
    assert "q3=#4,tau1=#5" in said


def test_joints_with_numbers_are_matched_by_these(tmp_path):
    names = [f"/a{k + 1}/{x}" for x in ("position", "effort") for k in SORTED]
    row, head = "t=t; q={s}; tau={s}", [",".join(["__time", *names])]
    path = log(tmp_path / "run.csv", row, head=head)
    same(read(path, ["joint_1", "joint_2", "joint_3"])[0])
