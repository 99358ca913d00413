"""The decision constants of the check: unit, meaning, and where each number comes from.

"Bench" is benchmarks/corruptions on its tuning arms (results/corruptions.md).
"""

from __future__ import annotations

import numpy as np

# -- rows and columns that hypotheses are judged on ----------------------------------------------------
#: Rows that hypotheses are tried on, and judged on (4 samples a parameter of a 7-axis arm).
TRIED, JUDGED = 160, 480
#: Rows for each independent sample of the low-passed torque.
DENSE = 1.2
#: Leads [s] of the torque at which it is filtered; between them it is interpolated.
LEADS = np.linspace(-0.25, 0.25, 11)
#: A joint slides at this share of its usual speed: slower, dry friction holds any torque between limits.
SLIDES = 0.2
#: Velocities over which Coulomb friction may turn [rad/s, m/s]: from a sign to a smooth one.
COULOMB_WIDTHS = (0.002, 0.03, 0.1)
#: Travels over which bristles bend before they slide [rad, m] (gears: 2e-4 to 2e-2).
BRISTLE_TRAVELS = (5e-4, 5e-3)
#: States that tell which parameters of the links are independent, for each joint.
STATES = 12

# -- the likelihood ------------------------------------------------------------------------------------
#: Relative ridge of the normal equations: directions that the motion does not excite stay quiet.
RIDGE = 1e-9
#: A residual below 0.3 % of the torque is explained: friction laws and filters are no better.
FLOOR = 1e-5
#: Rounds of reweighting each joint by its own residual.
ROUNDS = 3
#: Parts of the log that are left out in turn.
PARTS = 8
#: Physics may speak with so much (natural logarithm) on each joint: estimates of friction are rough.
LOUDEST = 60.0

# -- the search ----------------------------------------------------------------------------------------
#: Prior odds against any repair, and against one whose number is no round one (natural logarithms): one
#: log in some hundred has a given fault; multiples of 90 degrees and powers of ten come first.
ODDS, ODD_NUMBER = 6.0, 3.0
#: A repair is believed from these odds on (natural logarithm): one in a thousand by chance.
MIN_GAIN = 7.0
#: What the arm leaves of parts that it was not fitted to has to fall by so many standard errors.
SIGNIFICANT = 2.5
#: Standard deviations that a number has to lie beyond what is usual (Student's t of eight
#: parts, 99.5 %).
SIGMAS = 4.0
#: ... and by so much the log-likelihood falls to either side of it, within its reach (95 %).
CLOSED = 2.0
#: At most so many things are wrong at once; so many proposals are looked at closely.
MOST_FAULTS, CLOSELY = 6, 6

# -- what arms and loggers differ by themselves, and from where on a model of a log means nothing ----
#: Zeros are calibrated to so much [rad]; beyond GROSS_ZERO times as much it is no calibration.
CALIBRATED_ZERO, GROSS_ZERO = float(np.radians(1.5)), 7.0
#: Drives are calibrated to so much (natural logarithm); channels that differ by more than the second
#: make a model wrong, not only worse.
CALIBRATED_GAIN, WRONG_GAIN = 0.06, 0.5
#: A base is levelled to so much [rad]; from the second on no model of the log means anything.
LEVEL, MISMOUNTED = float(np.radians(2.0)), float(np.radians(10.0))
#: Drives and their drivers take as long [s].
USUAL_DELAY = 0.01
#: Other positions are asked for where more than this share of a torque's energy is left (3 % of it):
#: a wrong sign, order or quarter turn leaves more, even of slow motion.
UNEXPLAINED = 1e-3
#: Friction that warms up and slow noise look like a drift or a step (natural logarithm of the odds).
SLOW_ODDS = 15.0

# -- what is left over
#: What an arm leaves of its torques (root mean square, all joints together): with joint torque sensors,
#: and with torques from motor currents, whose friction is part of them. Twice as much is a warning.
TYPICAL = {"link": 0.05, "unknown": 0.05, "motor": 0.1}
#: Above this share of the energy, half of the torque, the arm's dynamics do not make it.
UNRELATED = 0.25
#: A joint contradicts its neighbours where one arm leaves so many times the energy that the joint's own
#: model leaves of it, and at least this share of the torque (root mean square).
CONTRADICTS = (6.0, 0.02)
#: A one-off event is a peak of the error so many times any other one.
EVENT = 3.0
#: Natural logarithm of the energy by which two arms in turn have to explain a log better than in
#: stripes.
TWO_ARMS = 1.5
#: Runs are set apart by so much (natural logarithm of the odds): friction, which is a run's own, is
#: never quite the same again.
APART = 20.0

# -- rows, clock and channels
#: A time step above so many medians is no jitter any more.
LONG = 5.0
#: A frozen channel or packet stays for so long [s] (packets for less are a warning), so many rows, and
#: this many times longer than it keeps its value elsewhere.
STUCK_SECONDS, STUCK_ROWS, STUCK_TIMES = 0.1, 10, 3.0
#: A spike leaves its neighbours by so many times their usual scatter, and this share of the range.
SPIKE = (40.0, 0.25)
#: A step between rows this many times the neighbours' is a hole behind a clock that was made again.
TORN = 2.5
#: A clipped channel stays at its end for so many samples, and so many times longer than elsewhere.
CLIPPED = (10, 3.0)
#: A mirrored torque turns at zero as fast as it came, in this share of its approaches at least.
MIRRORED = 0.6
#: Noise of quantisation above this share of the signal is worth a warning.
COARSE = 0.05
#: The filters need so many samples a period of the fastest motion.
SAMPLES_A_PERIOD = 30.0

# -- the size of torques
#: Shares of the effort limits between which torques have the right unit: a current is an order of
#: magnitude smaller.
EFFORT = (0.2, 3.0)
#: How far torques may be from those of a nominal arm, beside what its masses allow: friction, another
#: place of the masses, a gear that was left out.
MASS_SLACK = 4.0
