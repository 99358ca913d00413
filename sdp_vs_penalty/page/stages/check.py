"""Check: what the measurements look like, and what the check says of them."""

from functools import partial

from sdp_vs_penalty import formatting
from sdp_vs_penalty.page import controls as draw
from sdp_vs_penalty.page.arm import chart_and_arm
from sdp_vs_penalty.page.charts import data_chart
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.view import Part, Stage, Verdict, View


def _draw_check(view: View) -> None:
    session, units = view.session, view.session.robot["units"]
    _findings(session)
    views = {run["name"]: run["view"] for run in session.runs}
    first = next((run["name"] for run in session.runs if run["findings"]), next(iter(views)))

    def look(run: str) -> None:
        read = session.arrays(views[run])
        drawn.update_figure(data_chart(read, units))
        move(run, read)

    if len(views) > 1:
        with draw.tag("div", style="pick"):
            draw.choice("Run", [(n, n) for n in views], first, look, "checked-run")
    said = "Positions, velocities and torques of all joints over time"
    options = data_chart(session.arrays(views[first]), units)
    drawn, move = chart_and_arm(view, options, said, session.robot["drawn"], "nominal links")
    crosses = "Crosses: what the check would put there. "
    mended = any(found["can_fix"] for run in session.runs for found in run["findings"])
    draw.note(f"{crosses * mended}Drag to look closer; Play moves the arm.")
    look(first)


def _findings(session: Session) -> None:
    """What the check says, each with its repair; a tick where it says nothing."""
    with draw.tag("p", style="row"):
        for run in session.runs:
            if not run["findings"]:
                draw.tag("span", f"✓ {run['name']}", "tick")
    for run in session.runs:
        for found in run["findings"]:
            with draw.tag("p", style=f"finding {found['severity']}"):
                draw.tag("strong", f"{run['name']}: {found['kind']}. ")
                what = found["what"]
                draw.tag("span", f"{what[0].upper()}{what[1:]} What to do: {found['remedy']}.")
            if found["gravity"]:
                vector = ",".join(f"{g:g}" for g in found["gravity"])
                apply, key = partial(session.mount, vector), f"apply-{run['file']}"
                draw.button(f"Apply: gravity {vector}", apply, key, "primary")
        if any(found["can_fix"] for found in run["findings"]):
            apply = partial(session.mend, run["file"])
            draw.button(f"Apply to {run['name']}", apply, f"mend-{run['file']}", "primary")


def _checked(session: Session) -> Verdict | None:
    if not session.runs:
        return None
    if session.meaningless:
        return Verdict("bad", f"{session.meaningless[0]}.", "Check failed")
    warned = sorted({f["kind"] for run in session.runs for f in run["findings"]})
    if warned:
        return Verdict("usable", f"It found {formatting.words(warned)}.", "Check")
    return Verdict("good", f"Nothing wrong in {formatting.count(len(session.runs), 'run')}.", "Check")


_PART = Part("check", "", lambda s: bool(s.runs), lambda s: (s.robot["source"], s.runs), _draw_check)
CHECK = Stage("check", "Check", "Add measurements first.", (_PART,), _checked)
