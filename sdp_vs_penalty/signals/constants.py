"""The constants of signals: what counts as noise, as the same motion, as standstill, as
an event.

Sensitivity: each was halved and doubled on drawn logs of which the noise is known
(drawn arms with coloured, heavy-tailed, swelling and quantised noise, challenge's clean
and disturbed arms).
"""

#: The most samples that are worked on at once. A longer stretch has the mean of the
#: spectra of its pieces, and a longer motion is thinned before it is compared with
#: others. A run with more positions keeps its filtered rows in a file, not in memory.
SAMPLES = 1 << 18
#: A wider filter may let noise of a joint's positions through, up to this share of the
#: acceleration. Without this limit a point to point run of the UR10e (steps of 1e-4
#: rad) gets twice the cut-off, and its check warns of five joints.
NOISE_IN_ACCELERATION = 0.03
#: How many times wider the low-pass of the states is than that of the torque. An arm
#: without any filter of its torques (MuJoCo, 7 joints, sharp friction) seems to have one
#: of 7 ms (28 standard deviations) with equal low-passes, of 2.8 ms (5) with twice, and of
#: 1.7 ms (1.7) with three times the cut-off.
STATE_CUTOFF_RATIO = 3.0
#: Noise of a velocity may shift a reversal by this share of the time constant of the
#: torque's low-pass.
REVERSAL_SHIFT = 0.1
#: Seconds within which two instants are at the same phase of a motion.
SAME_PHASE = 0.25
#: A spectrum with so many times the power of the noise is motion; the motion makes the
#: variance of noise grow or shrink by no more than this factor.
MOTION_OVER_NOISE = 10.0
#: A kernel lets nothing of a motion through above so many cut-offs.
STOP_BAND = 1.5
#: Share of the sample rate up to which a log's spectrum is used: what lies above has
#: been averaged away between its samples.
USED_SHARE_OF_RATE = 0.45
#: Share of the windows that are quiet, and share that are loud.
QUIET_SHARE = 0.3
#: A spectrum is not that of noise if half of its amplitudes are off the law of noise by
#: more than this factor, or loud windows exceed quiet ones by more. Panda, UR10e, EMPS
#: 1.0 to 1.5; TX40 1.9 to 6; a UR10's smoothed torque 2.7 to 6.
NOISE_LIKE = 1.7
#: A joint slides above this share of its RMS speed: below it, dry friction turns round
#: or holds any torque between its limits.
SLIDING_SPEED = 0.2
