"""Table I: the sigmoid friction of every joint, published and fitted."""

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.bristles import PreslidingHysteresis
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.paper.sigmoid_friction import (
    RowsOf,
    SigmoidFit,
    exact_rows,
    fit_sigmoid,
    residual_rms,
)
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.paper.tables.table import Cell, Column, Maker, Table
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import filtered_torque, rows_per_sample

_UNITS = ("N*m", "s/rad", "rad/s")
_LINEAR = "rigid_body,viscous_friction,coulomb_friction,torque_offset"


def build(study: Study) -> Table:
    """Rows: phi_1..phi_3 published and fitted, each with its interval; then held-out errors."""
    n = study.problem.robot.n
    published = study.problem.published["table_I"]
    columns = [Column(name, 5) for name in published[0]]
    columns += [Column("what", 5), Column("covered_percent", 3)]
    rows: list[tuple[Cell, ...]] = [(*row.values(), "published", None) for row in published]
    rows += _rows_of("simulated, without noise", _exact(study), parts=1)
    fits = _replicates(study)
    truth = study.experiment.friction
    assert truth is not None
    # Share of the intervals of phi_1, phi_2, phi_3, over joints and fits, that hold the truth.
    share = np.mean([(fit.lower <= truth) & (truth <= fit.upper) for fit in fits], axis=(0, 1))
    rows += _rows_of("simulated", fits[0], 100.0 * share)
    # Half width [%] of the 95 % range of a share counted from so many intervals.
    expected = 196.0 * float(np.sqrt(0.95 * 0.05 / (len(fits) * n)))
    notes = _steps("simulated", fits[0])
    if study.measured is not None:
        study.progress("sigmoid friction of the real run")
        fit = _fit(study, study.measured, study.measured.train)
        rows += _rows_of("measured", fit)
        notes += _steps("measured", fit)
    for data in study.judged:
        rows += [
            (name, *errors.tolist(), "N*m", f"{data.label}, held-out RMSE", None)
            for name, errors in _held_out(study, data)
        ]
    return Table(
        "I",
        f"Table I: sigmoid friction of {study.problem.title}",
        study.sentence,
        tuple(columns),
        tuple(row if len(row) == n + 4 else (*row, None) for row in rows),
        (
            "Fitted together with the base parameters of the links: W pi + f(dq; phi) = tau, "
            "f = phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3)).",
            "lower, upper: 95 % intervals from the Jacobian of the whole fit; of phi_3 many are wide, "
            "and one that holds zero leaves the sign open. covered_percent: how many of them hold the "
            f"truth, over all joints and {len(fits)} simulated runs with different noise "
            f"({len(fits) * n} intervals: 95 % +- {expected:.0f} % expected).",
            *notes,
            "Held out: the residual of each friction model on the judged data, fitted on the training "
            "part by ordinary least squares; shapes too are chosen on the training part.",
        ),
    )


def _exact(study: Study) -> SigmoidFit:
    """From the true states at 50 Hz, without noise: what the fit recovers at best."""
    study.progress("sigmoid friction without noise")
    x = study.experiment
    t = np.arange(0.0, x.trajectory.duration, 0.02)
    motion = Motion(t, *x.trajectory.states(t))
    torque = np.sum([source(motion) for source in x.sources], axis=0)
    return fit_sigmoid(study.problem, exact_rows(motion, torque))


def _replicates(study: Study) -> list[SigmoidFit]:
    # Simulated runs with different noise from which the coverage of the intervals is counted.
    fits, count = [], study.effort.replicates
    for k in range(count):
        study.progress(f"sigmoid friction: simulated run {k + 1} of {count}")
        run = study.simulated.train if k == 0 else study.experiment.training_run(study.seed + k)
        fits.append(_fit(study, study.simulated, run))
    return fits


def _rows(data: Data, run: Measurements) -> RowsOf:
    return lambda model: filtered_torque(run, model, data.preprocessing)


def _rows_of(
    what: str, fit: SigmoidFit, covered: Array | None = None, parts: int = 3
) -> list[tuple[Cell, ...]]:
    """phi_1, phi_2, phi_3, each with its interval where all three parts are asked for."""
    rows: list[tuple[Cell, ...]] = []
    for k, unit in enumerate(_UNITS):
        share = None if covered is None else float(covered[k])
        for part, values in (("", fit.phi), (", lower", fit.lower), (", upper", fit.upper))[:parts]:
            cells = map(float, values[:, k])
            rows.append((f"phi_{k + 1}", *cells, unit, what + part, None if part else share))
    return rows


def _steps(what: str, fit: SigmoidFit) -> list[str]:
    """A note on the joints whose data want a step."""
    joints = ", ".join(map(str, np.flatnonzero(fit.at_bound) + 1))
    said = "phi_2 ran to the end of its range: the data want a step, and the interval means nothing."
    return [f"{what}: on joint(s) {joints} {said}"] if joints else []


def _fit(study: Study, data: Data, run: Measurements) -> SigmoidFit:
    """The sigmoid and the base parameters from one run behind the filters of a data set."""
    repeats = rows_per_sample(run, data.preprocessing)
    return fit_sigmoid(study.problem, _rows(data, run), repeats)


def _held_out(study: Study, data: Data) -> list[tuple[str, Array]]:
    """RMSE (n,) of three friction models on what is held out."""
    assert data.test is not None
    study.progress(f"friction models on held-out {data.label} data")
    fit = _fit(study, data, data.train)
    linear = _ordinary(study, data, _LINEAR)[1]
    grid = PreslidingHysteresis.shapes["d"].grid
    tried = [_ordinary(study, data, f"{_LINEAR},presliding_hysteresis@d={d}") for d in grid]
    best = min(range(len(grid)), key=lambda k: tried[k][0])
    held_out = [_rows(data, run) for run in data.test.runs()]
    return [
        ("linear friction", linear),
        ("sigmoid friction", residual_rms(study.problem, held_out, fit)),
        (f"presliding hysteresis (d = {grid[best]:g} rad)", tried[best][1]),
    ]


def _ordinary(study: Study, data: Data, effects: str) -> tuple[float, Array]:
    """Training loss and held-out RMSE (n,) of ordinary least squares with these effects."""
    own = replace(data, model=study.problem.model(effects))
    train = own.regression.least_squares()
    theta = np.asarray(np.linalg.lstsq(train.R, train.rho, rcond=1e-10)[0], float)
    return train.loss(theta), np.sqrt(own.errors(theta)[0])


TABLE = Maker("I", __doc__, build, ("panda",))
