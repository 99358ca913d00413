"""The decision constants of the race: unit, meaning, and where each number comes from
(worlds and drawn arms with seeds of their own, where nothing else is said)."""

import numpy as np

# -- rows and columns that hypotheses are judged on
#: Rows that hypotheses are judged on, and one in so many of them that the first look is
#: taken at.
ROWS = 320
THIN = 3
#: Velocities over which Coulomb friction may turn [rad/s, m/s]: from a sign to a smooth
#: one.
COULOMB_WIDTHS = (0.002, 0.03, 0.1)
#: Travels over which bristles bend before they slide [rad, m]: gears' (2e-4 to 2e-2) as
#: an own column, longer ones as a law that the model lacks.
TRAVELS = {"gear": (5e-4, 5e-3), "hysteresis": (2e-2, 1e-1, 0.5)}
#: Parts of the log that are left out in turn.
PARTS = 8

# -- the evidence (natural logarithms)
#: Friction may speak with so much on each joint, and the links' likeness to the nominal ones
#: against their mirror image.
MAX_PHYSICS_LOG_ODDS = 60.0
#: Standard deviation of the share of a torque that friction has where a controller
#: compensates it.
COMPENSATED = 0.03
#: Standard deviation of the natural logarithm of the arm's size beside the nominal one;
#: another unit of all torques makes it anything.
MASSES_KNOWN = 0.5
#: Log-odds of rows in order beside velocities of the other sign.
VELOCITY_TURNED = -9.0
#: Prior odds against a fault of all runs, against a difference of one run or part
#: (friction never repeats exactly), against a drift or a step.
LOG_ODDS_AGAINST_FAULT = 6.0
LOG_ODDS_AGAINST_DIFFERENCE = 3.0 * LOG_ODDS_AGAINST_FAULT
LOG_ODDS_AGAINST_EVENT = 3.0 * LOG_ODDS_AGAINST_FAULT
#: Squared residuals whose logarithms differ by less are the same fit.
SAME_FIT = 0.2

# -- the race
#: Log-odds from which on a hypothesis is taken, and from which on it is called likely: arms
#: have what no hypothesis has, and odds are too bold (results/reliability/odds.md). One that
#: is less likely than the best by no more than it takes to be taken is told with it.
LOG_ODDS_OF_A_CLAIM = 20.0
LIKELY = 45.0
#: Hypotheses that are looked at on all rows, and the least log-odds at the first look (with
#: 4 a drift of half a standard deviation is lost, whose log-odds are 48 on all rows).
LOOKS = 12
WORTH_A_LOOK = -4.0
#: At most so many things are wrong at once.
MAX_FAULTS = 6

# -- the second witness: parts of the log that nothing was fitted to
#: Standard errors by which the error there has to fall.
WITNESS_SIGMAS = 2.0
#: Factor by which the energy that is left there has to fall, of some joint or of all
#: together: for what is there or not (a sign, an axis, an order), for what has a size,
#: which adapts to whatever the model lacks, and of a motion of few directions, in which
#: much explains much.
LEAST_RATIO = 1.5
LEAST_RATIO_WITH_SIZE = 2.0
LEAST_RATIO_IF_DOUBTFUL = 4.0
#: Widest 95 % interval of a number that is claimed, to either side: of a factor (natural
#: logarithm), of an angle [rad].
WIDEST = 0.35
#: Standard deviations that a number has to be away from what it was, and beyond what is
#: usual (Student's t of seven degrees, one-sided: 99 %, 99.7 %).
NUMBER_SIGMAS = 3.0
SIGMAS_BEYOND_USUAL = 4.0

# -- what arms and loggers differ by themselves
#: Zeros and bases are calibrated to so much [rad].
CALIBRATED = float(np.radians(1.5))
#: Drives, the rate of clocks and the size of gravity are known to so much (natural
#: logarithm).
CALIBRATED_GAIN = 0.06
#: Friction differs by such a share from run to run, by the temperature of its grease [-].
USUAL_FRICTION = 0.25
#: Drives and their drivers take as long; a command is ahead of its torque by more than
#: clocks are of each other [s].
USUAL_DELAY = 0.01
USUAL_LEAD = 0.002
#: Share of a torque's energy that filters and rounding leave, and the least one, of all
#: joints together, that a claim explains: 0.3 % of the torque.
FLOOR = 1e-6
LEAST_SHARE = 1e-5
#: Share of a torque's energy above which a joint is poorly explained: more than the
#: errors of friction laws and filters; and above which something else is missing, or
#: two mistakes were made.
POORLY = 2e-5
BADLY = 0.01
#: Radians of a count: encoders have more than a hundred and twenty of them a turn.
LARGEST_COUNT = 0.05
