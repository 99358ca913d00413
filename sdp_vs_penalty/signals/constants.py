"""The constants of signals: what counts as noise, as the same motion, as standstill, as
an event.

Sensitivity: each was halved and doubled on drawn logs of which the noise is known
(drawn arms with coloured, heavy-tailed, swelling and quantised noise, challenge's clean
and disturbed arms).
"""

#: Samples of one spectrum (a longer stretch has the mean of the spectra of so many
#: each); instants at which two motions are compared; time steps of which a median is
#: taken, in stretches that are spread over a longer run. Positions of a run whose rows,
#: and the low-passed columns of the last model, are kept in memory; those of a longer
#: one in a file.
SAMPLES = 1 << 18
#: Share of the acceleration that the noise of a joint's positions may be behind a wider filter.
#: Without it a point to point run of the UR10e (steps of 1e-4 rad) is cut off at twice
#: the frequency, and its check warns of five joints.
NOISY = 0.03
#: How many times wider the low-pass of the states is than that of the torque. Behind
#: equal ones an arm without any filter of its torques (MuJoCo, 7 joints, sharp friction)
#: seems to have one of 7 ms, at 28 standard deviations; 2 times: 2.8 ms, 5; 3: 1.7 ms, 1.7.
WIDER = 3.0
#: Share of the torque's time constant by which noise of a velocity may shift a reversal.
EARLY = 0.1
#: Seconds within which two instants are at the same phase of a motion.
SAME_PHASE = 0.25
#: Motion is what has so many times the power of the noise.
ABOVE = 10.0
#: In cut-offs: where a kernel has stopped, and with it what it lets through of a
#: motion. In sample rates: the last frequency of a log, beyond which it has been
#: averaged away between its samples.
STOPS = 1.5
LAST = 0.45
#: Share of the windows that are quiet, and share that are loud.
QUIET = 0.3
#: The factor of amplitudes beyond which a spectrum is no noise's: half of them off its law, or loud
#: windows above quiet ones. Panda, UR10e, EMPS 1.0 to 1.5; TX40 1.9 to 6; a UR10's smoothed torque
#: 2.7 to 6.
NOISE_LIKE = 1.7
#: A joint slides at this share of its usual speed: slower, dry friction turns round and
#: holds any torque between limits.
SLIDES = 0.2
