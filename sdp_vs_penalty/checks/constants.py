"""The decision constants of the check: unit, meaning, and where each number comes from
(the bench of results/corruptions on its tuning arms, where nothing else is said)."""

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

#: Rows have a fault of their own where one arm for all explains a joint so many times worse
#: there than an arm of fewer rows does.
OUTLYING = 3.0

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
