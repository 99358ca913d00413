"""Figures 1, 2, 3 and 9: motions, measured and estimated torques, and the errors beside them."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.paper.figures.style import (
    BLUE,
    LOOKS,
    ORANGE,
    label_joints,
    legend_below,
    new_figure,
    title,
)
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import filtered_torque

_METHODS = ("lmi-sdp", "penalty")


@dataclass(frozen=True)
class Torques:
    """t (M,) s; measured and each method's torque (M, n), behind the same filters."""

    t: Array
    measured: Array
    estimated: dict[str, Array]

    @classmethod
    def of(cls, study: Study, data: Data, run: Measurements, methods: tuple[str, ...]) -> Self:
        rows = filtered_torque(run, data.model, data.preprocessing)
        estimated = {m: predicted(rows, study.result(m, data).theta) for m in methods}
        return cls(rows.motion.t - run.t[0], rows.torque, estimated)

    def relative_error(self, method: str) -> float:
        """100 |tau - tau_hat| / |tau| over all joints [%]."""
        error = self.measured - self.estimated[method]
        return 100.0 * float(np.linalg.norm(error) / np.linalg.norm(self.measured))

    def draw(self, joint: int, torque_axis: Any, error_axis: Any | None, name: str) -> None:
        """Torque of one joint on one axis, errors of all methods on the other."""
        torque_axis.plot(self.t, self.measured[:, joint], label=name, **LOOKS["measured"])
        for method, torque in self.estimated.items():
            torque_axis.plot(self.t, torque[:, joint], label=method, **LOOKS[method])
            if error_axis is not None:
                error = torque[:, joint] - self.measured[:, joint]
                error_axis.plot(self.t, error, label=method, **LOOKS[method])
        torque_axis.margins(x=0)
        if error_axis is not None:
            error_axis.margins(x=0)


def exciting_trajectory(study: Study) -> Any:
    """Figure 1: measured and estimated torques along the exciting trajectory, with errors."""
    data = study.measured or study.simulated
    torques = Torques.of(study, data, data.train, ("ols", "lmi-sdp"))
    n = study.problem.robot.n
    figure, axes = new_figure(n, 2, 1.25 * n + 0.6, sharex=True, width_ratios=(3, 2))
    for j in range(n):
        torques.draw(j, axes[j, 0], axes[j, 1], data.label)
    label_joints(axes, study.problem.robot.torque_units, "torque")
    axes[0, 0].set_title("torque")
    axes[0, 1].set_title("error: estimated less " + data.label)
    legend_below(figure, axes[0, 0])
    errors = ", ".join(f"{m} {torques.relative_error(m):.2f} %" for m in ("ols", "lmi-sdp"))
    title(
        figure,
        f"Exciting trajectory, {data.label}: relative error {errors} (the paper: 1.41 %, CLS), "
        f"below {data.preprocessing.torque_cutoff:g} Hz",
    )
    return figure


def validation_trajectories(study: Study) -> Any:
    """Figure 2: the validation trajectories."""
    n, judged = study.problem.robot.n, study.judged
    figure, axes = new_figure(n, len(judged), 1.15 * n + 0.6, sharex="col", sharey="row")
    for k, data in enumerate(judged):
        assert data.test is not None
        run = data.test.runs()[0]
        t = run.t - run.t[0]
        for j, joint in enumerate(study.problem.robot.joints):
            axes[j, k].plot(t, run.q[:, j], color=BLUE, linewidth=1.0, label="position")
            for limit in (joint.lower, joint.upper):
                axes[j, k].axhline(
                    limit, color=ORANGE, linestyle="--", linewidth=0.8, label="joint limit"
                )
            axes[j, k].margins(x=0)
        first = (
            f"first of {len(data.test.runs())}"
            if len(data.test.runs()) > 1
            else "held out of the real run"
        )
        axes[0, k].set_title(f"{data.label} ({first})")
    label_joints(axes, study.problem.robot.position_units, "position")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], loc="outside lower center", ncols=2, frameon=False)
    title(figure, "Validation trajectories (the paper's own are not public)")
    return figure


def validation_torques(study: Study) -> Any:
    """Figure 3: torques along the validation trajectories."""
    n, judged = study.problem.robot.n, study.judged
    figure, axes = new_figure(n, 2 * len(judged), 1.25 * n + 0.6, sharex="col")
    notes = []
    for k, data in enumerate(judged):
        assert data.test is not None
        torques = Torques.of(study, data, data.test.runs()[0], _METHODS)
        for j in range(n):
            torques.draw(j, axes[j, 2 * k], axes[j, 2 * k + 1], "recorded")
        axes[0, 2 * k].set_title(f"{data.label}: torque")
        axes[0, 2 * k + 1].set_title(f"{data.label}: error")
        notes.append(f"{data.label} {torques.relative_error('lmi-sdp'):.2f} %")
    label_joints(axes, study.problem.robot.torque_units, "torque")
    legend_below(figure, axes[0, 0])
    title(figure, "Held-out torques; relative error of lmi-sdp: " + ", ".join(notes))
    return figure


def torques_of_the_2r(study: Study) -> Any:
    """Figure 9: torques of the 2R, true ones and with parameters retrieved by penalty and by SDP."""
    robot, x, data = study.problem.robot, study.experiment, study.simulated
    t = np.arange(0.0, x.trajectory.duration, 0.02)
    states = x.trajectory.states(t)
    true = robot.inverse_dynamics(x.links.ravel(), *states)
    figure, axes = new_figure(robot.n, 2, 4.2, sharex=True, width_ratios=(3, 2))
    gaps, worst = [], []
    for j in range(robot.n):
        axes[j, 0].plot(t, true[:, j], label="p_real", **LOOKS["true"])
    for method in _METHODS:
        result = study.result(method, data)
        links = result.theta[data.model.rigid_indices]
        torque = robot.inverse_dynamics(links, *states)
        worst.append(f"{method} {1e3 * np.abs(torque - true).max():.1f} mN m")
        if result.certificate.gap is not None:
            gaps.append(f"{method} {abs(result.certificate.gap):.0e}")
        for j in range(robot.n):
            axes[j, 0].plot(t, torque[:, j], label=method, **LOOKS[method])
            axes[j, 1].plot(t, 1e3 * (torque - true)[:, j], label=method, **LOOKS[method])
    for axis in axes.flat:
        axis.margins(x=0)
    for j in range(robot.n):
        axes[j, 1].set_ylabel("error [mN m]")
    label_joints(axes, robot.torque_units, "torque")
    legend_below(figure, axes[0, 0])
    title(
        figure,
        f"2R, identified from one noisy simulated run: largest torque errors {', '.join(worst)};\n"
        f"certified gaps {', '.join(gaps)} of the loss",
    )
    return figure
