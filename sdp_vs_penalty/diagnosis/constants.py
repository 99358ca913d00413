"""The numbers that decide what a diagnosis says: unit, meaning, and source or
sensitivity of each.

Evidence is twice the logarithm of odds (Kass, Raftery, JASA 1995); shares have no unit.
"""

# The score.

#: Rows of a joint beyond which more of them tell no law better (Miller, Dunson, JASA
#: 2019). Of six weak effects (seed 61001) 300 name none and 1000 name two; of three
#: that 1000 does not name (73000) 3000 names two, and nothing false in 14 clean cases.
COARSENING_ROWS = 3000.0
#: Share of a column's energy below which the model makes it itself, and a form is
#: judged without it: what is left is a hundredth of it, about as wrong as columns of
#: filtered positions are. MuJoCo's spring of 6 N m/rad left less than 1e-3, and is known
#: to 12 %.
ABSORBED = 1e-4
#: The same for what splines make of a curve, whose roughness is in doubt as well.
ABSORBED_CURVE = 0.02
#: Clusters of rows, by time and by phase of the motion: 30 to 60 are what
#: cluster-robust variances need (Cameron, Miller, J. Human Resources 2015, sec. VI).
CLUSTERS = 50

#: Travel [rad, m] after which friction has forgotten how it was bent when the log
#: began, to a twentieth: three times that of gears' bristles (Dahl, AIAA Journal 1976).
FORGETS = 0.03

# The search.

#: Evidence from which a term is taken: odds of 150 to 1, "very strong" (Kass, Raftery,
#: sec. 3.2). From 6 on 65 of 101 weak effects are named, not 61, and on the real TX40
#: the wrist's friction no more.
EVIDENCE_TO_ADD = 10.0
#: Evidence by which another form must fall short to be told from a term: odds of 20 to
#: 1, "strong" (ibid.).
EVIDENCE_TO_DISTINGUISH = 6.0
#: Share of what a term explains from which another candidate is looked at, beside which
#: constants are not refined yet.
PROMISING = 0.5
#: A law is right to this share of what it explains: so much of it looks like what acts
#: where it does.
LAW_TOLERANCE = 0.04
#: Candidates that are looked at closely.
MAX_CANDIDATES_REFINED = 4

#: Parts of a log over which sizes and help scatter, as the check's repairs do.
PARTS = 8

# Data left out.

#: Folds by phase that decide what is offered: they leave much out (Shao, JASA 1993), or
#: judge what has nearly been seen. On another motion in 40 worlds with several torques
#: without a name the confident findings alone raise the sum of log errors in 9 with
#: five, in 6 with three; two lose 2 of 12 effects.
THIRDS = 3
#: Those by which the share of an error that something explains is told (five or ten:
#: Hastie, Tibshirani, Friedman, Elements of Statistical Learning, 7.10).
FOLDS = 5
#: Share by which a held-out error has to fall or rise, less is minor; and of the
#: squares of an event's window that its extent may leave out.
MINOR = 0.01
#: Fall of the sum of log errors by an effect that is not judged again while another one
#: does harm; the last round judges all of them.
SURE_HELP = 0.05
#: Fewest rows in which a joint slides that a fit can do with.
FEWEST_SLIDING = 60
#: Fall of that sum by an effect in least squares that shows its help: on 6 logs
#: constraints and their prior changed 120 such falls by 0.35 at most.
CLEAR_HELP = 0.5

# What is left.

#: Chance that repetitions as few as these show the noise as too low as makes what is
#: left, in rows that are evidence, a matter: with 1000 degrees of freedom 1.4 times its
#: variance.
CHANCE = 1e-3
#: Factor within which a spectrum tells the noise in simulations (.5 to 1.7 of the truth
#: on 51 logs): a residual has to be that many times the noise to be unexplained.
SPECTRUM_NOISE_FACTOR = 2.0
#: Share by which it has to raise a joint's error above its noise to matter.
MIN_ERROR_RISE = 0.1

# Confidence.

#: Relative standard deviation of a size from which it is uncertain; and share of its
#: energy that other findings leave below which it is not its own: its deviation is then
#: 2.2 times as large as alone.
UNCERTAIN = 0.2
#: Standard deviation over size from which that is not told from zero ("two sigma"); with
#: the error of all shape constants, which may be as large as the size of a known torque.
SIGNIFICANT = 0.5
#: Standard deviations from which a constant is another one ("three sigma").
IMPLAUSIBLE_SIGMAS = 3.0
#: Share by which findings together may raise a joint's error on data left out.
MAX_JOINT_HARM = 0.05
