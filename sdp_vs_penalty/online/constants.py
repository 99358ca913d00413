"""The numbers that decide in the control loop, each with its unit and its reason."""

#: s: longest delay of the filters.
MAX_DELAY = 0.05
#: kg and m: standard deviation of a payload's mass and reach before it is measured.
PAYLOAD_MASS = 5.0
PAYLOAD_REACH = 0.2
#: s: data of a payload count exp(-1) after so long.
FORGETTING = 30.0
#: s: friction and offsets drift over so long; 0 turns their tracking off.
DRIFT = 60.0
#: Standard deviation of friction that has drifted, as a share of friction itself.
#: Offsets drift by the same share of dry friction.
DRIFT_SHARE = 0.1
#: Natural logarithm of the odds that a change needs, a million to one: about one of the
#: million instants in a quarter of an hour at 1 kHz is a pick.
CHANGE_EVIDENCE = 13.8
#: s: steps between the instants at which a change may have happened, and how far back.
CHANGE_STEP = 0.02
CHANGE_REACH = 2.0
#: Data fade once in so many steps: all kept instants fade together, which would cost too
#: much in every step.
CHANGE_STEPS_PER_FADE = 10
#: s: shortest stretch after a change that is judged.
CHANGE_SHORTEST = 0.06
#: s: a change is believed if it still is one so long after it was suspected: a bump is
#: over by then.
CHANGE_WAIT = 0.2
#: s: each kept instant is judged once in this time; up to three times as long in a fast
#: loop with a payload, where a cycle either projects it or judges.
CHANGE_JUDGED_EVERY = 0.1
#: rad/s or m/s: below this speed dry friction can have any value up to its size.
REST_SPEED = 0.01
#: rad or m: travel over which friction settles after a turn (exp(-1)).
SETTLING_TRAVEL = 0.01
#: Share of a payload's torque that gears lose or return: their efficiency is 90 %.
LOAD_FRICTION = 0.1
#: s: a payload is projected onto the physically consistent ones this often.
PROJECTION_PERIOD = 0.01
#: Certified gap of a projection in units of half a squared standard deviation.
PROJECTION_GAP = 1e-4
#: Newton steps of a projection.
PROJECTION_STEPS = 30
