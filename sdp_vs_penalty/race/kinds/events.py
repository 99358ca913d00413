"""What one joint's torque holds beside the arm's: a drift with time, or a step at some moment
(a contact, a load, a zero set anew). Proposed by a score test: of each shape the part that
the arm leaves, against the residual."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.stretches.gaps import recorded_seconds
from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogEvent, LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, Runs, joints_text, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis
from sdp_vs_penalty.robot.arrays import Array, Indices

DRIFT = "torque drift"
#: Smallest share of the rows before a step, and of those after it, in which the joint
#: moves either way: of a joint that only turns back, friction makes a step.
_SMALLEST_SHARE_EACH_WAY = 0.15
#: A step has to say something new beside the joint's own columns, and the arm's
#: parameters leave at least so large a share of it [-].
_NOTHING_NEW_SHARE, _SHARE_LEFT_BY_ARM = 1e-10, 1e-3


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield a drift of each joint's torque, and the likeliest step; nothing if the fit
    already explains a part of the log by itself.

    A step's prior counts the moments that a low-passed torque can distinguish.
    """
    log, current = evidence.log, fit.transform
    if fit.view.parts or fit.view.extra_torques:
        return
    prior = prior_of_one_of(log.n) - c.LOG_ODDS_AGAINST_EVENT + c.LOG_ODDS_AGAINST_FAULT
    for j in log.joints:
        yield Hypothesis(DRIFT, (j,), prior, current.with_event(LogEvent(j)))
    for event in _likeliest_step(evidence, fit):
        transform = current.with_event(event)
        odds = prior - float(np.log(c.ROWS // c.PARTS))
        yield Hypothesis("torque step", (event.joint,), odds, transform)


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each drift and each step that is taken out of a joint's
    torque."""
    for event in transform.events:
        yield (_drift if event.at is None else _step)(log, transform, event)


def _likeliest_step(evidence: Evidence, fit: ViewFit) -> Iterator[LogEvent]:
    """Yield the torque step that lowers a joint's squared residual most, of all joints
    and moments.

    A step is proposed only for a joint that moves both ways before it and after it:
    otherwise Coulomb friction makes the same step.
    """
    log, current = evidence.log, fit.transform
    motion = log.data.motion
    # One moment for two rows: a step two rows off explains nothing. Near the ends of
    # the log a step is an offset.
    shares = np.linspace(0.12, 0.88, c.ROWS // 2)
    rows_before = (shares * (len(motion.t) - 1)).astype(np.intp)
    moments = motion.t[rows_before].tolist()
    first_rows = rows_before + 1
    falls = _log_falls_by_steps(evidence, fit, first_rows) * log.moving[:, None]
    # Share of the rows before and after each step in which a joint moves forth.
    goes_forth = motion.dq[:, list(current.order)].T > 0.0
    n_forth = np.cumsum(goes_forth, axis=1)[:, first_rows - 1]
    n_forth_in_all = goes_forth.sum(axis=1)[:, None]
    n_after = len(motion.t) - first_rows
    share_before = n_forth / np.maximum(first_rows, 1)
    share_after = (n_forth_in_all - n_forth) / n_after
    for share in (share_before, share_after):
        falls = falls * (np.minimum(share, 1.0 - share) > _SMALLEST_SHARE_EACH_WAY)
    j, k = divmod(int(np.argmax(falls)), len(moments))  # joint, moment
    if falls[j, k] > 0.0:
        yield LogEvent(j, moments[k])


def _log_falls_by_steps(evidence: Evidence, fit: ViewFit, first_rows: Indices) -> Array:
    """Predict the falls (n, K) of log S_j by columns x that step from 0 to 1 at some of
    the rows (K,).

    S_j is the squared residual of joint j. To first order it falls by (x . r)^2 / v,
    with the residual r and v the square of what is left of x beside the joint's own
    columns and the arm's parameters. No column is made: a product with a step is a
    sum over the rows from the step on.
    """
    rows = fit.columns.rows
    mask = evidence.log.torque_mask(fit.transform)

    def from_rows(y: Array) -> Array:
        """Return the sums (n, K, ...) of y (n, M, ...) from each step's row on."""
        # Cumulative sums from the last row backwards.
        sums_to_end = np.cumsum(y[:, ::-1], axis=1)[:, ::-1]
        return sums_to_end[:, first_rows]

    on_residual = from_rows(mask * evidence.residual(fit))  # (n, K): x . r
    on_arm = from_rows(mask[:, :, None] * rows.projected).swapaxes(1, 2)
    on_basis = from_rows(mask[:, :, None] * rows.basis)
    squares = from_rows(mask)
    explained = np.sum(on_arm * np.linalg.solve(fit.information, on_arm), axis=1)
    beside_basis = squares - np.sum(on_basis**2, axis=2)
    beside_arm = beside_basis - fit.weights[:, None] * explained
    beside_arm = np.maximum(beside_arm, _SHARE_LEFT_BY_ARM * beside_basis)
    scale = np.maximum(beside_arm * fit.energy_left[:, None], 1e-280)
    is_new = beside_basis > _NOTHING_NEW_SHARE * squares
    return is_new * np.log1p(on_residual**2 / scale)


def _size(log: Likelihood, transform: LogTransform, event: LogEvent) -> float:
    """Return the size of a drift or step [N m or N].

    It is the least-squares coefficient of the event's shape x in the torque y that the
    arm leaves of the joint, (x . y) / (x . x), with the joint's own columns (friction,
    offset) projected out of x.
    """
    j = event.joint
    fit = log.fit(transform)
    rows = log.rows(transform.without_event(event))
    shape = log.torque_mask(transform)[:, :, None] * event.shape(log.data.motion.t)
    x = rows.project_out_own(shape)[j, :, 0]
    y = fit.channels[j] - rows.projected[j] @ fit.theta
    return float(x @ y / max(float(x @ x), 1e-300))


def _drift_from_end_to_end(
    log: Likelihood, transform: LogTransform, event: LogEvent
) -> float:
    """Return by how much a joint's torque drifts from a log's first row to its last
    [N m or N].

    The fitted ramp is extrapolated: filters cut the rows at both ends of the log.
    """
    seconds_of_rows = max(recorded_seconds(log.data.motion.t), 1e-300)
    return _size(log, transform, event) * log.data.seconds / seconds_of_rows


def _drift(log: Likelihood, transform: LogTransform, event: LogEvent) -> Fault:
    """Return the fault that a joint's torque drifts linearly over the log."""
    size = _drift_from_end_to_end(log, transform, event)
    unit = log.torque_unit(event.joint)
    return Fault(
        kind=DRIFT,
        joints=(event.joint,),
        what=f"the torque of {joints_text([event.joint])} drifts by {size:+.3g} {unit}"
        " from the first row to the last.",
        remedy="let the sensor warm up and set its zero before the run",
        without=transform.without_event(event),
        in_words_of_runs=_drift_of_runs,
        figures={"size": size},
    )


def _drift_of_runs(fault: Fault, runs: Runs) -> Fault:
    """Return the fault that a joint's torque drifts, in the words of several runs: by
    how much from the first row of a run to its last, in the run that drifts most.

    The ramp over the rows of all runs has an offset in each run: its size is no change
    that any run shows.
    """
    event = LogEvent(fault.joints[0])
    sizes = [
        _drift_from_end_to_end(log, transform, event) for _, log, transform in runs
    ]
    largest = int(np.argmax(np.abs(sizes)))
    name, log, _ = runs[largest]
    unit = log.torque_unit(event.joint)
    return replace(
        fault,
        what=f"the torque of {joints_text(fault.joints)} drifts by up to"
        f" {sizes[largest]:+.3g} {unit} from the first row of a run to its last ({name}).",
        figures={"size": sizes[largest], "sizes": sizes},
    )


def _step(log: Likelihood, transform: LogTransform, event: LogEvent) -> Fault:
    """Return the fault that a joint's torque steps and stays there."""
    size = _size(log, transform, event)
    name = joints_text([event.joint])
    unit = log.torque_unit(event.joint)
    return Fault(
        kind="torque step",
        joints=(event.joint,),
        what=f"the torque of {name} steps by {size:+.3g} {unit} at t = {{t:.4g}} s and"
        " stays there.",
        remedy="cut the run there, or find out what touched the arm",
        without=transform.without_event(event),
        place=f"{name}, t = {{t:.4g}} s",
        figures={"size": size},
        at=event.at,
    )
