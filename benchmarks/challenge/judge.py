"""Is a diagnosis right? Answers of yes and no about the record of one case, and Wilson's interval."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from challenge.classes import FARTHEST, IDENTIFIABLE

Record = dict[str, Any]
Item = Mapping[str, Any]

#: What a diagnosis of a clean robot can come to; the first is a false claim.
OUTCOMES = ("false", "named", "abstained", "silent")


def wilson(hits: float, count: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's score interval of a share (JASA 1927); (0, 1) without cases."""
    if count == 0:
        return 0.0, 1.0
    p = hits / count
    centre = p + z**2 / (2 * count)
    half = z * np.sqrt(p * (1 - p) / count + z**2 / (4 * count**2))
    scale = 1 + z**2 / count
    return max(0.0, float((centre - half) / scale)), min(1.0, float((centre + half) / scale))


def counted(record: Record) -> bool:
    """Each hidden effect by itself is visible in these data, and moves links as machines do; one without
    a name is visible beside any one effect of the library."""
    beyond = record.get("curve", {}).get("beyond", np.inf)
    visible = all(e > IDENTIFIABLE for e in (*record["energy"], beyond))
    return visible and all(d <= FARTHEST for d in record["deviation"])


def same(found: Item, truth: Item) -> bool:
    """The effect on its joint; on several joints, with their ratios."""
    ratios = [k for k in truth["shape"] if re.fullmatch(r"c\d+", k)] if "shape" in truth else []
    return bool(
        found["effect"] == truth["effect"]
        and found["joints"] == truth["joints"]
        and all(found["shape"].get(k) == truth["shape"][k] for k in ratios)
    )


def is_true(found: Item, record: Record) -> bool:
    return any(same(found, t) for t in record["truth"])


def claims(record: Record) -> list[Item]:
    """Findings but those that are only fair to name under these conditions."""
    return [f for f in record["found"] if f["effect"] not in record["fair"] or is_true(f, record)]


def extras(record: Record) -> list[Item]:
    """Claims that are not hidden."""
    return [f for f in claims(record) if not is_true(f, record)]


def first(record: Record) -> Item | None:
    """The first claim."""
    return next(iter(claims(record)), None)


def first_right(record: Record) -> bool:
    named = first(record)
    return named is not None and is_true(named, record)


def in_set(record: Record) -> bool:
    """A hidden effect is the first named one, or among those that it cannot be told apart from."""
    named = first(record)
    if named is None:
        return False
    rivals = {r.split(":")[0] for r in named["indistinguishable_from"]}
    return is_true(named, record) or any(t["effect"] in rivals for t in record["truth"])


def all_named(record: Record) -> bool:
    return all(any(same(f, t) for f in record["found"]) for t in record["truth"])


def nothing_else_confident(record: Record) -> bool:
    return not any(f["confidence"] == "confident" for f in extras(record))


def abstained(record: Record) -> bool:
    return bool(record["verdict"] == "unknown_effect")


def flagged(record: Record) -> bool:
    return bool(record["events"]) or abstained(record)


def found_in_time(record: Record) -> bool:
    """An event overlaps the disturbance, give or take a second; a hum goes on all the time."""
    truth = record["truth"][0]
    if truth["kind"] == "hum":
        return flagged(record)
    return any(
        e["t_start"] < truth["t_end"] + 1.0 and e["t_end"] > truth["t_start"] - 1.0
        for e in record["events"]
    )


def has_curves(record: Record) -> bool:
    return bool(record.get("curves"))


def right_variables(record: Record) -> bool:
    """Of the first curve of the joint that misses a torque."""
    return bool(record.get("curve", {}).get("variables"))


def mostly_removed(record: Record) -> bool:
    """Most of the missing energy, on a motion that nothing was fitted to."""
    return bool(record.get("curve", {}).get("removed", 0.0) >= 0.8)


def false_claim(record: Record) -> bool:
    return outcome(record) == "false"


def outcome(record: Record) -> str:
    """Of OUTCOMES, of a clean robot. False: an effect that is not fair to name, at whatever confidence;
    an abstention where it is not fair; a refusal of what a real arm might have measured."""
    unknown = abstained(record)
    if extras(record) or record["verdict"] == "refused" or (unknown and not record["abstains"]):
        return "false"
    if record["found"] or record["retuned"]:
        return "named"
    return "abstained" if unknown else "silent"


def sizes(record: Record) -> list[tuple[str, float, float]]:
    """Of hidden effects that are named and have one size: effect, its relative error, and the error in
    standard deviations. Amplitudes of waves have no sign. Where a nuisance makes the same effect too (a
    filter in the channel, which delays) the size is that of both, and is not judged."""
    out = []
    for truth in record["truth"]:
        for f in record["found"]:
            if same(f, truth) and truth.get("size") is not None and f["effect"] not in record["fair"]:
                wave = f["effect"] in ("torque_ripple", "base_tilt", "payload")
                size = abs(f["size"]) if wave else f["size"]
                error = size - truth["size"]
                deviations = error / f["std"] if f["std"] > 0.0 else float("inf")
                out.append((f["effect"], abs(error / truth["size"]), abs(deviations)))
                break
    return out
