"""The decision constants of the check: unit, meaning, and where each number comes from
(the bench of results/corruptions on its tuning arms, where nothing else is said)."""

import numpy as np

# -- rows and columns that hypotheses are judged on ----------------------------------------------------
#: Rows that hypotheses are judged on.
ROWS = 320
#: Velocities over which Coulomb friction may turn [rad/s, m/s]: from a sign to a smooth
#: one.
COULOMB_WIDTHS = (0.002, 0.03, 0.1)
#: Travels over which bristles bend before they slide [rad, m]: gears' (2e-4 to 2e-2) as
#: an own column, longer ones as a law that the model lacks.
TRAVELS = {"gear": (5e-4, 5e-3), "hysteresis": (2e-2, 1e-1, 0.5)}

# -- the likelihood ------------------------------------------------------------------------------------
#: Parts of the log that are left out in turn.
PARTS = 8
#: Physics may speak with so much (natural logarithm) on each joint's friction and on
#: the weight; on inertia, which is differentiated twice, with less: it must not decide
#: alone.
MAX_PHYSICS_LOG_ODDS = 60.0
MAX_INERTIA_LOG_ODDS = 12.0
#: Centres of mass of a robot's description are right to so much [m]: what it says of the
#: weight's sign is worth no more (tools' drawings, and what identified models differ by).
CENTRE_OF_MASS = 0.02
#: Mean square of the joints' weight torque that is rounding, as a share of the square of
#: the arm's weight at one metre [m^2].
NO_WEIGHT = 1e-10

# -- the search ----------------------------------------------------------------------------------------
#: Prior odds against any repair (natural logarithm): one log in some hundred has a given
#: fault. Explanations that differ by less are as likely.
LOG_ODDS_AGAINST_FAULT = 6.0
#: Posterior log-odds from which on a fault is claimed as likely: 20 to 1.
LOG_ODDS_OF_A_CLAIM = 3.0
#: A repair that lowers the log-likelihood by so much is not tried again before another
#: fault is repaired: a law of friction brings no such repair back.
HOPELESS_LOSS = 100.0
#: Standard errors by which what the arm leaves of parts that it was not fitted to has
#: to fall (half of them where a number tells as well), and that a number has to lie
#: beyond what is usual (Student's t of PARTS, 99.5 %). More parts would be shorter than
#: the slow part of a motion, and look more certain than they are.
REQUIRED_SIGMAS = 4.0
#: A fault is claimed only where it divides the energy that is left over on parts left
#: out by so much, of some joint or of all together, beside all laws of friction and
#: position that may explain the same: one of a few (a sign, an axis, an order), or one
#: with a number, which adapts to whatever the model lacks. No joint's may rise by more
#: than the last.
LEAST_RATIO_WITHOUT_SIZE = 1.5
LEAST_RATIO_WITH_SIZE = 2.0
LARGEST_ERROR_RISE = 1.2
#: The same of a motion of few directions, in which much explains much.
LEAST_RATIO_IF_DOUBTFUL = 4.0
#: One arm for all runs has to explain them so many times worse than one for each.
TIMES_BETTER = 1.5
#: Rows have a fault of their own where one arm for all explains a joint so many times worse
#: there than in another run, or than an arm of fewer rows does: friction and loads that differ
#: from day to day make less.
OUTLYING = 3.0
#: Widest 95 % interval of a number that is claimed, to either side: of a factor (natural
#: logarithm), of an angle [rad].
WIDEST = 0.35
#: At most so many things are wrong at once; so many proposals are looked at closely.
MAX_FAULTS = 6

# -- what arms and loggers differ by themselves, and from where on a model of a log means nothing ----
#: Zeros and bases are calibrated to so much [rad].
CALIBRATED = float(np.radians(1.5))
#: Drives, the rate of clocks and the size of gravity are known to so much (natural
#: logarithm).
CALIBRATED_GAIN = 0.06
#: Drives and their drivers take as long [s].
USUAL_DELAY = 0.01

# -- what is left over
#: What an arm leaves of its torques (root mean square, all joints together): with joint torque sensors,
#: and with torques from motor currents, whose friction is part of them. Twice as much is a warning, and
#: so is quantisation that adds as much noise.
TYPICAL = {"link": 0.05, "unknown": 0.05, "motor": 0.1}
#: Above this share of the energy, half of the torque, the arm's dynamics do not make
#: it; and up to this share of the base parameters, rotors included, an ordinary motion
#: of a good arm leaves unseen.
UNRELATED = 0.25
#: Torques are a model's where the weight alone leaves less of their energy, in any
#: joint: friction is a hundred times that. Torques resemble those of an arm where their
#: squared correlation with a nominal one's is above the second.
MODEL_OF_WEIGHT = 1e-4
RESEMBLES = 0.3
#: A joint contradicts its neighbours where one arm leaves so many times the energy that
#: the joint's own model leaves of it, and at least this share of the torque's energy.
CONTRADICTS = (2.0, 1e-4)

# -- rows, clock and channels
#: A step of the clock longer than so many usual ones is a gap: one lost row makes two, and
#: jitter adds less than another.
GAP = 3.0
#: A stretch in which a channel repeats a value, or lies on a line, is a fault where it is so
#: many times as long as usual ones: a logger faster than its source makes those.
LONG_STRETCH = 3.0
#: A frozen channel or packet stays for so many rows (in which a joint that comes to
#: rest slows down; twice as many freezes are a coarse sensor), and so long [s] (packets
#: for less are a warning).
STUCK = 10
STUCK_SECONDS = 0.1
#: Fewest rows that tell anything of a run, of one that follows another in one file or
#: comes twice.
RUN = 50
#: A spike leaves its neighbours by so many times their usual scatter, and this share of
#: the range.
SPIKE = (40.0, 0.25)
#: Identification goes on with a log of which a smaller share is no measurement.
MOST_LOST = 0.1
#: From so many rows that repeat a time on, the clock is coarse: no row is a copy.
MOST_REPEATED = 0.05
#: Joints whose positions correlate so much move in proportion.
LOCKSTEP = 0.995
#: A joint's equations are fitted to so many rows a column at least; directions of columns below
#: this share of the largest are not seen.
ROWS_A_COLUMN = 3.0
SEEN_DIRECTIONS = 1e-3
#: The filters need so many samples a period of the fastest motion.
SAMPLES_A_PERIOD = 30.0

# -- the size of torques
#: Shares of the effort limits between which torques have the right unit: a current is an order of
#: magnitude smaller. As far as the second they may be from those of a nominal arm, beside what its
#: masses allow: friction, another place of the masses, a gear that was left out.
EFFORT = (0.2, 3.0)

# -- what a fact leaves to be judged
#: Facts after which nothing is left to be judged.
NO_ROWS = "no rows", "channel without numbers", "static poses"
#: Facts after which no dynamics are judged: what they would say of the torques is theirs.
NO_DYNAMICS = (
    *NO_ROWS,
    "no motion",
    "too little data",
    "unusable rows",
    "torque magnitude",
    "change of rate",
    "clock against velocity",
    "units of the problem",
)
