"""Diagnose: the error from model to model; which effects are missing, each to be added
with a click."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

from nicegui import ui

from sdp_vs_penalty import formatting
from sdp_vs_penalty.api.remedies import next_remedy
from sdp_vs_penalty.diagnosis.finding import Finding, Retune
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.offers import Pair
from sdp_vs_penalty.diagnosis.sentences import besides
from sdp_vs_penalty.effects import effect_types, effects_in_words, standard_effect
from sdp_vs_penalty.page import controls as draw
from sdp_vs_penalty.page.charts import failing_chart, finding_chart, missing_chart
from sdp_vs_penalty.page.model_step import is_among
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.spoken import spoken
from sdp_vs_penalty.page.view import (
    PagePart,
    Stage,
    StageVerdict,
    View,
    identified,
    label_of_motion,
    look_in_words,
    measured_on,
    requires_model,
)
from sdp_vs_penalty.render.pieces import bars
from sdp_vs_penalty.render.tables import joint_table
from sdp_vs_penalty.render.words import (
    BADGES,
    DiagnosisWords,
    FindingWords,
    describe_diagnosis,
    describe_files,
    parts_of,
    plain_name,
    weak_title,
)
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.signals.noise import said_before


@partial(
    PagePart,
    "history",
    "",
    lambda s: s.model is not None,
    lambda s: [[model.comparison, model.findings is None] for model in s.history],
)
def models(view: View) -> None:
    """Draw each joint's error, from model to model where there are several; of a diagnosed
    one, with what would be added next."""
    session = view.session
    if session.hidden_and_found:
        draw.tag("p", session.hidden_and_found, "words")
    history = session.history
    units = session.torque_units
    before = history[0].comparison["rmse"]
    after = history[-1].comparison["rmse"] if len(history) > 1 else None
    floor = history[-1].comparison["noise_floor"]
    scope = measured_on(session, names_runs=True)
    torque = history[-1].comparison["torque_rms"]
    colours: dict[str, Any] = {}
    if (diagnosis := session.findings_of_current) is not None:
        offers = [x for x in diagnosis.offers if x.is_advisable]
        choices = diagnosis.offers.choices or offers[:1]
        before = diagnosis.held_out_rmse_before
        after, other = [*(choice.after for choice in choices), None, None][:2]
        if other is not None:
            names = [choice.change.words.removeprefix("add ") for choice in choices]
            words = f"now (grey); with {names[0]} (blue), with {names[1]} (light blue)"
            colours = {"colours": words, "other": other}
    drawn = bars(before, after, floor, units, scope, torque=torque, **colours)
    ui.html(drawn, sanitize=False)
    if diagnosis is not None and (held := describe_files(diagnosis)):
        draw.note(held)
    if len(history) == 1:
        return
    with draw.details("What the model holds", "model-holds", on=True), draw.tag("ul"):
        draw.tag("li", f"At first: {effects_in_words(history[0].effects)}.")
        for below, step in pairwise(history):
            again = [x for x in step.added if is_among(x, below.effects)]
            new = [text for text in step.added if text not in again]
            for word, texts in (("Added", new), ("Estimated again", again)):
                if texts:
                    draw.tag("li", f"{word}: {effects_in_words(texts)}.")
    facts = {str(k): model.facts for k, model in enumerate(history, start=1)}
    with draw.details(f"Error (RMS) {scope}, as a table", "history-table"):
        draw.judged(history)
        draw.table(joint_table(facts, units), "Error of each joint, model by model")


@requires_model(
    "findings",
    "",
    lambda s: (s.findings and s.findings.to_dict(), [r["name"] for r in s.runs_since]),
)
def findings(view: View) -> None:
    """Draw what the last diagnosis found, with buttons to add it, and one to
    diagnose.
    """
    session = view.session
    diagnosis = view.session.findings
    _unexplained(view)
    if diagnosis is None:
        draw.note(
            "Every effect of the library is tried on the error, and named only if it"
            " holds on data that did not select it."
        )
    else:
        words = describe_diagnosis(diagnosis, session.torque_units)
        if session.findings_of_current is not None:
            _parts(diagnosis)
        _cards(view, diagnosis, words)
        _open_before(view, diagnosis)
        _curves(view, diagnosis, words)
        _others(view, diagnosis, words)
    with draw.tag("div", style="row"):
        again = "Diagnose" if diagnosis is None else "Diagnose again"
        diagnose = partial(session.start, session.diagnose)
        draw.button(again, diagnose, "diagnose")
        if session.runs_since:
            look = partial(session.start, session.find_change)
            draw.button(look_in_words(session), look, "diagnose-frozen")
    if not session.runs_since:
        draw.note(
            "To weigh a load: bring a run with it under Measure. The model stays as it"
            " is, and what the load adds is found."
        )
    _by_hand(view)


def _unexplained(view: View) -> None:
    """Draw the error of the joint that the verdict names, against what it depends on,
    where no card shows it: there is no diagnosis of the model yet, or nothing to add."""
    session = view.session
    model = session.current
    diagnosis = session.findings_of_current
    if not model.failures or (diagnosis and next_remedy(diagnosis.remedies)):
        return
    view.look_at_worst_joint()
    run = view.run if view.run in model.runs else model.runs[-1]
    drawn, title = failing_chart(session, run)
    draw.tag("h4", f"{title}, in {run}")
    draw.chart(drawn, title)


def _parts(diagnosis: Diagnosis) -> None:
    """Draw what each choice adds that counts several: each once, with what it does to the
    error, and how sure it is."""
    for k, offer in enumerate(diagnosis.offers.choices):
        parts = parts_of(offer, diagnosis)
        if len(parts) < 2:
            continue
        what = formatting.sentence(offer.change.words.removeprefix("add "))
        with (
            draw.details(f"{what}: what each does", f"parts-{k}", on=k == 0),
            draw.tag("ol", style="findings"),
        ):
            for part in parts:
                with draw.tag("li", style="row"):
                    draw.tag("strong", part.title)
                    draw.tag("span", part.badge, "badge good")
                    draw.tag("span", part.gain, "soft")


def _cards(view: View, diagnosis: Diagnosis, words: DiagnosisWords) -> None:
    """Draw a card for each finding and each constant to re-estimate: first those whose
    torque is certain, as they are read; the others are folded away. The main one is
    unfolded, or, where none is or it was added, that of the joint that errs most.

    The position of a finding in the diagnosis numbers its card, so that both lists use
    the same numbers.
    """
    session = view.session
    opened = diagnosis.offers.main_finding
    if opened is None:
        worst = session.current.worst_joint
        on_worst = (
            f for f in diagnosis.offers.in_order_of_reading if f.main_joint == worst
        )
        opened = next((f for f in on_worst if f.text not in session.added), None)
    sure, others = list[partial[None]](), list[partial[None]]()
    covered = set[str]()  # drawn on the card of the one that needs it
    for group in diagnosis.offers.groups_in_order_of_reading:
        k = group.place
        if group.first.text in covered:
            continue
        shown = {*group.texts}
        if (pair := diagnosis.offers.pair_of(group.first)) and pair.is_mutual:
            covered.add(pair.other.text)
            shown.add(pair.other.text)
        is_open = opened is not None and opened.text in shown
        card = partial(_card, view, diagnosis, words, k, is_open)
        (sure if group.first.torque_is_certain else others).append(card)
    for k, constant in enumerate(diagnosis.retuned):
        if constant.text in covered:
            continue
        if (pair := diagnosis.offers.pair_of(constant)) and pair.is_mutual:
            covered.add(pair.other.text)
        card = partial(_constant, session, diagnosis, words, k)
        (sure if constant.torque_is_certain else others).append(card)
    with draw.tag("ol", style="findings"):
        for card in sure:
            card()
    if not others:
        return
    added = [f for f in diagnosis.effects if f.text in session.added]
    added = [finding for finding in added if not finding.torque_is_certain]
    title = weak_title(len(others), len(added))
    is_unfolded = opened is not None and not opened.torque_is_certain
    with draw.details(title, "weak-findings", on=not sure or is_unfolded):
        if words.shared_doubt:
            draw.note(words.shared_doubt)
        with draw.tag("ol", style="findings"):
            for card in others:
                card()


def _open_before(view: View, diagnosis: Diagnosis) -> None:
    """Draw what an earlier diagnosis found and the model holds, but of which the name is
    open, each with the motion that decides it."""
    session = view.session
    before = [step.findings for step in session.history if step.findings]
    still_open = {  # once, as it was found last
        finding.title: finding
        for earlier in before
        for finding in (() if earlier is diagnosis else earlier.effects)
        if finding.rating != "confident" and finding.undecided is not None
        if is_among(finding.text, session.current.effects)
    }
    if not still_open:
        return
    count = formatting.count(len(still_open), "effect")
    title = f"In the model, and not decided: {count}"
    with draw.details(title, "open-before", on=len(still_open) <= 3):
        for finding in still_open.values():
            with draw.tag("div", style="row"):
                draw.tag("strong", finding.title)
                draw.tag("span", finding.badge, f"badge {finding.rating}")
                if rivals := finding.rivals_in_words:
                    draw.note(f"Fits as well: {rivals}.")
                _telling(view, finding, "", f"tell-before-{finding.number}")


def _card(
    view: View, diagnosis: Diagnosis, described: DiagnosisWords, k: int, is_open: bool
) -> None:
    """Draw the card of one finding, the k-th of the diagnosis (from 0).

    Its head says what the effect is, how sure, and what adding it does to the error,
    beside the button to add it; unfolded, it shows the joint's error against its cause
    and the evidence.
    """
    session = view.session
    finding, words = diagnosis.effects[k], described.findings[k]
    name, texts = words.title, [finding.text]
    change = diagnosis.offers.offer_of(finding).change
    if pair := diagnosis.offers.pair_of(finding):
        name, texts, change = pair.title, pair.texts, pair.change
    is_added = session.added.issuperset(texts)
    done = " done" if is_added else ""
    with draw.tag("li", style=f"card finding-card{done}"):
        # What is said of several weak findings at once calls them by their numbers.
        number = "" if finding.torque_is_certain else f"{finding.number}. "
        title = f"{number}{name}"
        gain = "" if is_added else words.brief_gain  # the chart has what it did
        with _head(title, f"card-{k}", is_open, words, gain):
            draw.tag("p", words.on_the_arm, "on-the-arm")
            if words.badge in BADGES and not finding.says_open_law:  # the evidence does
                meaning = f"{formatting.sentence(words.badge)}: {BADGES[words.badge]}."
                draw.note(meaning)
            if pair is not None:
                draw.note(_other_of_pair(diagnosis, described, pair))
            _picture(session, diagnosis, finding)
            draw.tag("h5", "Evidence")
            with draw.tag("ul", style="evidence"):
                for sentence, speaks_for_it in words.evidence:
                    draw.tag("li", sentence, "for" if speaks_for_it else "against")
            if words.test:
                _telling(view, finding, words.test, f"tell-{k}")
            if words.physics or words.constants:
                with draw.details("What this effect is, and does", f"physics-{k}"):
                    draw.note(words.physics)
                    if words.constants:
                        draw.note(f"Its constants: {words.constants}.")
        helps = finding in diagnosis.offers.helping or not finding.torque_is_certain
        word = "Add" if helps else "Add anyway"
        _adding(session, texts, change.to_dict(), f"add-{k}", f"{word} {name}", word)


def _other_of_pair(diagnosis: Diagnosis, described: DiagnosisWords, pair: Pair) -> str:
    """Return what the other one of a pair is on the arm, or which constant it is."""
    if isinstance(pair.other, Retune):
        constant = described.constants[diagnosis.retuned.index(pair.other)]
        return f"{constant.title}: {pair.other.explanation}."
    return described.findings[diagnosis.effects.index(pair.other)].on_the_arm


def _head(
    title: str,
    key: str,
    is_open: bool,
    words: FindingWords | None = None,
    gain: str = "",
) -> Any:
    """Draw the head of a card: its title, how sure it is, and what adding it does to the
    error (``gain``); fill what it unfolds in a ``with`` statement."""
    unfolded = draw.tag("details", open=is_open)
    with unfolded, draw.tag("summary", style="head", data_key=key):
        draw.tag("h4", title)
        if words is not None:
            colour = "good" if words.helps else "weak"
            meaning = BADGES.get(words.badge, "")
            draw.tag("span", words.badge, f"badge {colour}", title=meaning)
            draw.tag("span", gain, "soft")
    return unfolded


def _picture(session: Session, diagnosis: Diagnosis, found: Finding | Retune) -> None:
    """Draw the error that a finding, or a constant to re-estimate, explains; or a pair."""
    drawn = finding_chart(session, diagnosis, found)
    if drawn is not None:
        pair = diagnosis.offers.pair_of(found)
        title = found.title if pair is None else pair.title
        draw.chart(drawn, f"Error that {title} explains, against its cause")
        draw.note("Added: by how much the model changes, all its numbers fitted again.")


def _telling(view: View, finding: Finding, words: str, key: str) -> None:
    """Draw the button that makes the motion by which an open question is decided, or
    what to do where no motion decides it."""
    session = view.session
    if finding.undecided is None:
        draw.note(f"To decide it: {words}")
        return
    change = {"arguments": {"separate": [*finding.undecided]}}
    make = partial(session.start, session.make_motion, change, view.download)
    draw.button(label_of_motion(change), make, key)


def _adding(
    session: Session,
    texts: Sequence[str],
    change: Mapping[str, Any],
    key: str,
    label: str,
    word: str = "Add",
) -> None:
    """Draw the button that adds what a card holds, or the remark that it was added.

    texts : its effects as `add` writes them; change : what adds them; key : by which
    focus finds the button again; label : what it adds, for screen readers; word : what
    the button says.
    """
    if session.added.issuperset(texts):
        draw.tag("p", "✓ Added", "chosen")
    elif session.is_of_held_model(texts[0]):
        draw.note("The model has it, of another size: identify it again.")
    else:
        add = partial(session.start, session.apply, change)
        draw.button(word, add, key, aria_label=label)


def _constant(
    session: Session, diagnosis: Diagnosis, described: DiagnosisWords, k: int
) -> None:
    """Draw the card of a constant of the model's effects, the k-th, that should be
    re-estimated."""
    constant, words = diagnosis.retuned[k], described.constants[k]
    name, texts, change = words.title, [constant.text], constant.remedy.change
    if pair := diagnosis.offers.pair_of(constant):
        name, texts, change = pair.title, pair.texts, pair.change
    with draw.tag("li", style="card finding-card"):
        gain = "" if session.added.issuperset(texts) else words.brief_gain
        with _head(name, f"card-constant-{k}", False, words, gain):
            _picture(session, diagnosis, constant)
            draw.tag("p", words.physics)
            if pair is not None:
                draw.note(_other_of_pair(diagnosis, described, pair))
            if words.doubt:
                draw.note(words.doubt)
        key = f"add-constant-{k}"
        _adding(session, texts, change.to_dict(), key, f"Add {name}")


def _curves(view: View, diagnosis: Diagnosis, words: DiagnosisWords) -> None:
    """Draw each measured curve of missing torque that no effect explains.

    It has its 95 % band and a button to add it to the model as a table.
    """
    session = view.session
    units = view.session.torque_units
    texts = session.diagnosed.curve_texts
    curves = zip(diagnosis.curves, words.curves, texts, strict=True)
    for k, (curve, sentence, text) in enumerate(curves):
        done = " done" if text in session.added else ""
        with draw.tag("div", style=f"card finding-card{done}"):
            name = f"Missing torque without a name, joint {curve.joint}"
            with _head(name, f"card-curve-{k}", is_open=not diagnosis.helpful):
                draw.tag("p", formatting.sentence(sentence))
                recording = session.recording(session.current, view.run)
                drawn = missing_chart(curve, units, recording)
                label = f"Missing torque of joint {curve.joint}, with its band"
                draw.chart(drawn, label)
            title = f"Add the curve of joint {curve.joint}"
            change = Change("add", title, {"effects": [text]})
            _adding(session, [text], change.to_dict(), f"add-curve-{k}", title)


def _by_hand(view: View) -> None:
    """Draw lists to choose any effect and its joint from, and the button that adds it.

    This is needed for a payload of a fixed model, or for what the diagnosis did not
    name.
    """
    session = view.session
    kinds = effect_types()
    joints = [
        (str(k), f"{k} {name}") for k, name in enumerate(session.robot["joints"], 1)
    ]
    chosen = {"effect": standard_effect("payload").name, "joint": ""}

    def add() -> None:
        kind = kinds[chosen["effect"]]
        place = "" if kind.whole_robot else chosen["joint"]
        session.start(session.add, ":".join(filter(None, (kind.name, place))))

    with draw.details("Add another effect", "by-hand"):
        with draw.tag("div", style="fields"):
            put = partial(partial, chosen.__setitem__)
            effects = [(name, plain_name(name)) for name in kinds]
            draw.choice(
                "Effect", effects, chosen["effect"], put("effect"), "add-effect"
            )
            places = [("", "each joint"), *joints]
            draw.choice("On", places, "", put("joint"), "add-joint")
        draw.button("Add it", add, "add-by-hand")


#: What a diagnosis asks for where the noise is not known from repetition.
_REPEAT = "Record a run with more than one period"


def _others(view: View, diagnosis: Diagnosis, words: DiagnosisWords) -> None:
    """Draw remarks, disturbances at single instants, each with a button that leaves it
    out, and effects that these runs cannot show.
    """
    session = view.session
    for cause in diagnosis.passing:
        draw.tag("p", f"{formatting.sentence(cause.sentence)}.", "finding")
    for remark in (*besides(diagnosis), *words.remarks):
        draw.note(spoken(said_before(remark)))
        if _REPEAT in remark:
            make = partial(session.start, session.make_motion, {}, view.download)
            draw.button("Make a motion to repeat", make, "repeat")
    if words.invisible:
        with draw.details("What these runs cannot show", "invisible"):
            draw.note("The model's existing parameters absorb the torque of:")
            with draw.tag("ul"):
                for text in words.invisible:
                    draw.tag("li", text)


def _diagnosed(session: Session) -> StageVerdict | None:
    """Return the mark of a diagnosed model, which is that of its verdict; what was found
    stands in view, and what it did in the bars."""
    verdict = identified(session)
    return verdict and replace(verdict, text="") if session.findings else None


DIAGNOSE = Stage(
    "diagnose", "Diagnose", "Identify a model first.", (models, findings), _diagnosed
)
