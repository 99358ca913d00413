"""Decisions of this folder that are numbers, each with its unit, its meaning and where
it is from."""

import numpy as np

#: Probability of every interval, and of the decision that a separating run is to make
#: right [-].
LEVEL = 0.95
#: Quantile of the normal distribution for LEVEL, in which standard deviations are
#: given.
#: The value of scipy.special.ndtri((1 + LEVEL) / 2), written out: scipy.special takes
#: longer to import than the program to answer `list`.
NORMAL_95 = 1.959963984540054
#: Length of the sandwich's window in correlation times. Chosen for 95 % coverage at
#: forty of them a run.
WINDOW = 20.0
#: Degrees of freedom for which the mean over all directions counts. Chosen on white
#: runs of 3 and 4 s and AR runs of 20 s, with seeds of their own: 2
#: covers up to 97.5 % in 3 s, 4 only 92.0 in 20 s.
POOLED = 3.0
#: Largest half-width of an interval of each verdict: relative to the value, or to the
#: largest value there could be (a parameter that is zero is known well if it is known
#: to be small).
WIDTHS = {"identifiable": (0.25, 0.0025), "weakly": (1.0, 0.1)}
#: Standard deviation of the logarithm of a gain before anything is measured.
GAIN_PRIOR = 0.3
#: Distance [m] of a load's mass from the last link's frame, as a standard deviation.
LOAD_REACH = 0.3

#: Smaller numbers are the rounding of a zero in every unit that is shown (kg, kg m^2, N
#: m, ...).
ROUNDING = 1e-9
#: Share by which a joint's error or a shape constant changes, of an error that
#: something explains, or of rows outside of a measured curve, before it is said,
#: coloured or counted [-].
CHANGES = 0.05
#: Most passes of least squares for the current model of torque-dependent effects [-]. Each
#: leaves a share of the error before that is as large as the gain is off.
MAX_PASSES = 10

#: Steps of central differences, in states (rad, rad/s, rad/s^2) and in scales of shape
#: constants, where truncation and rounding cost the same (Press et al., Numerical
#: Recipes, 5.7).
DIFFERENCE = float(np.cbrt(np.finfo(float).eps))
#: Folds of the motion by which a shape constant is confirmed, and a servo's law chosen
#: [-]; stretches of it whose errors an interval takes for independent, where no torque
#: is logged.
SHAPE_FOLDS = 10

#: Least cut-off of positions over the highest harmonic of the command, where no torque
#: is logged [-]: the motion that answers it has harmonics of its own, from gravity and
#: friction. Chosen on 24 logs with encoders of 12 and 18 bits, where 5 let more noise
#: through, and 7 joints, where 2 lost the scale.
COMMAND_HARMONICS = 3.0
#: Share of its column that others must leave of a parameter which sets a scale [-], and
#: the least correlation of a motor's current or voltage with its servo's torque (the
#: EMPS: 0.9999).
SCALE_TOLD = 1e-5
MOTOR_ALIKE = 0.7
#: Velocities over which dry friction may turn round while the servo's law is sought
#: [rad/s, m/s]; the widest is tried after it too: a simulator's friction is that soft.
TURNS = (1e-3, 0.01, 0.05, 0.25)
#: How far Taylor's series of a command reaches, in which a law's delay is sought [s].
DELAY_REACH = 0.02
#: What a wrong law of friction lets a gain too many lower the held-out error by [-]: on
#: 25 simulated logs at most 1.19 where a missing gain raises it 1.24 times or more. A
#: delay that is none lowers it by less than the root of that: at most 1.02 on 6 logs,
#: 1.18 to 1.76 on 14 with 5 to 18 ms. Simulations whose errors differ by less show the
#: same motion.
FEWER_GAINS = 1.2
#: What a lead of dry friction lowers the held-out error by at least, to be in a model
#: of servos [-]: 1.05 to 3.2 on 17 simulated logs, whose gains it mends; 1.00 to 1.03 on
#: 10 with little motion, a saturated drive or coarse encoders.
LEAD = 1.04
#: Demanded torques over the largest one from which a drive may be limited [-].
LIMIT_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9)
#: A drive is limited if the demand above such a level explains this share of the squared
#: residual or more (limited ones: 0.20 to 0.55; 30 others: 0.05 or less), and this share
#: of the demand above the level, or more, is missing [-].
LIMIT_EXPLAINS = 0.12
LIMIT_MISSING = 0.5
#: The residual at such demands over that at smaller ones, at least [-]: 3.4 to 9 for
#: limited drives, and at most 1.4 where it is noise of an error of few counts.
LIMIT_RATIO = 2.0
