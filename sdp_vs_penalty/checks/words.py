"""What is said of a log's rows, clock and channels: severity, sentence, how sure, what to do; once."""

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.checks.issue import Issue, Repair

_READ = "certain: read from the file"
_NO_ARM = "certain: no joint moves like that"
_STILL = "certain: the positions change by noise only"

#: By kind; braces are figures of the issue, or its ``where``.
_WORDS = {
    "missing numbers": (
        "error", "{count} rows with values that are not finite numbers, or that no robot measures.",
        _READ, "delete those rows",
    ),
    "time unit": (
        "error", "time is in {unit}, not in seconds (it advances by {step:.4g} from row to row).",
        "{sure}", "multiply t by {factor:g}",
    ),
    "time runs backwards": (
        "error", "the clock is set back {count} times, by up to {seconds:.3g} s: {how}.", _READ,
        "{remedy}",
    ),
    "repeated time": (
        "error", "{count} rows with a repeated time; the values {how}.", _READ, "keep the first "
        "of each",
    ),
    "jittered time stamps": (
        "warning", "the time steps vary by {percent:.0f} %, but the positions are {ratio:.0f} "
        "times smoother over the row number than over these times: the samples are evenly spaced, "
        "the time stamps are not.", "likely: if the sampling itself jittered, the motion would be "
        "smoother over the recorded times", "space the time stamps evenly (and log the samples' "
        "own time)",
    ),
    "clock step": (
        "warning", "the clock jumps ahead by up to {seconds:.3g} s while the moving arm does not: "
        "the clock was set, and no sample is missing.", "likely: the distance travelled is that "
        "of one usual step", "continue the time at the usual step there",
    ),
    "gap in time": (
        "warning", "{count} gaps of up to {seconds:.3g} s (the usual step is {step:.3g} s); in "
        "all {total:.3g} s are missing.", _READ, "no action needed: the run is split there, and "
        "the filters lose a second on either side",
    ),
    "wrapped angle": (
        "error", "the position of {where} jumps by a full turn between two rows: the angle is "
        "wrapped.", _READ, "unwrap the angle",
    ),
    "repeated run": (
        "error", "{rows} rows are copies, bit by bit, of rows {lag} earlier: a part of the run is "
        "in the file twice, and would count as a repetition without noise.", _READ,
        "delete the copies",
    ),
    "frozen packets": (
        "error", "all channels repeat one row for up to {seconds:.3g} s, {parts} times, while the "
        "arm moves on: no packets came.", _READ, "delete these rows",
    ),
    "doubled rows": (
        "error", "{rows} rows are copies of the row before, and the motion does not skip ahead "
        "after them: rows were doubled and the clock was made again.", _READ, "delete the copies "
        "and their time",
    ),
    "repeated packets": (
        "warning", "{rows} rows repeat the one before, and the motion skips ahead after them: "
        "packets were lost, and the logger wrote the last one again.", _READ, "delete the copies",
    ),
    "interpolated rows": (
        "error", "{rows} rows lie on straight lines in every channel: a gap was filled by "
        "interpolation.", _READ, "delete these rows; the run is split there",
    ),
    "zeros": (
        "error", "{named} exactly zero in {rows} rows, and jumps there and back: nothing was "
        "measured.", "certain: the channel hardly ever takes any other value near zero",
        "replace single rows by interpolation, delete longer parts",
    ),
    "spikes": (
        "error", "{samples} samples of {named} lie far from the samples on both sides.", _NO_ARM,
        "replace them by interpolation",
    ),
    "lost rows": (
        "error", "at {count} places every joint skips ahead within one time step: about "
        "{lost:.0f} rows are missing and the clock was made again.", "certain: all joints skip by "
        "the same time", "put the missing time back",
    ),
    "frozen position": (
        "error", "the position of {named} repeats one value for {seconds:.3g} s, {parts} times, "
        "while the arm moves: the channel was frozen.", "certain: elsewhere it never repeats for "
        "nearly as long", "delete these rows",
    ),
    "frozen torque": (
        "error", "the torque of {named} repeats one value for {seconds:.3g} s, {parts} times, "
        "while the arm moves: the channel was frozen.", "certain: elsewhere it never repeats for "
        "nearly as long", "delete these rows",
    ),
    "idle joints": (
        "warning", "{where} never moves: friction and inertia about that axis are not "
        "identifiable, and the torque there is stiction.", _STILL, "move every joint, or add a "
        "run that does",
    ),
    "stand-still": (
        "note", "the arm stands still for {seconds:.3g} s in total; these rows are not used.",
        "certain: no joint moves for half a second", "no action needed, or record a longer motion",
    ),
    "dead channel": (
        "error", "{where} is {value:g} {unit} in every row.", _READ, "find out why the logger "
        "wrote a constant",
    ),
    "torque magnitude": (
        "error", "{where} never changes sign: the logger wrote magnitudes.", "likely: a torque "
        "passes through zero, and does not turn round there", "log the torque with its sign",
    ),
    "saturation": (
        "warning", "{channel} is stuck at {limit:.6g} {unit} for up to {longest} consecutive "
        "samples ({samples} in total): the channel is clipped.", "likely: elsewhere it is never "
        "constant for more than {elsewhere} samples", "record again with a larger range, or "
        "slower; delete those rows until then",
    ),
    "quantisation": (
        "warning", "{where} is quantised in steps of {step:.3g} {unit}, which adds noise of about "
        "{percent:.0f} % of the {seen} below {hertz:.3g} Hz.", "likely: the steps are read from "
        "the file, the noise is estimated", "log more digits, or move faster; a lower cut-off "
        "helps a little",
    ),
    "low sample rate": (
        "warning", "the motion reaches {highest_hz:.3g} Hz, and {rate_hz:.3g} samples per second "
        "are too few to differentiate it twice: {needed:.0f} Hz are needed.", "certain: from the "
        "spectrum of the positions", "log faster, or move slower",
    ),
    "velocity channel": (
        "warning", "{where}: {name}, compared with the derivative of the position.", "{sure}",
        "{remedy}",
    ),
    "no motion": (
        "error", "no joint moves: these data contain only static friction and the weight in one "
        "pose.", _STILL, "record a motion of all joints",
    ),
}  # fmt: skip


def said(
    kind: str, where: str, repair: Repair | None = None, severity: str = "", **figures: Any
) -> Issue:
    """An issue of this kind; severity : other than usual."""
    usual, *texts = _WORDS[kind]
    what, sure, remedy = (text.format(where=where, **figures) for text in texts)
    return Issue(kind, severity or usual, where, what, sure, remedy, repair, figures)
