from pathlib import Path

from sdp_vs_penalty.cli import console


def verb(out: Path = Path("demo")) -> None:
    """Show the main job on a simulated 7-joint arm in which one effect is hidden.

    Example: sdp-vs-penalty demo --out demo

    --out DIR: Folder for runs, models and report.
    """
    from sdp_vs_penalty.cli import printing
    from sdp_vs_penalty.render.tables import model_table
    from sdp_vs_penalty.reports.demo import ARM, RUNS, demo

    with console.progress("simulating") as progress:
        demonstration = demo(out, progress=progress)
    before = demonstration.compared[-1]
    units = demonstration.model.torque_units
    console.say(
        f"A simulated {ARM} arm: two runs to identify from, one to judge on ({out})."
    )
    console.say("1. Identify: the same runs by three methods", style="bold")
    rows = [(c.name, c.verdict.grade, c.facts()) for c in demonstration.compared]
    title = "On motion that was not used for fitting"
    console.table(model_table(rows, "method", title))
    console.say("2. Compare: where the physically consistent model fails", style="bold")
    printing.where_it_fails(demonstration.failures, before)
    console.say("3. Diagnose", style="bold")
    console.paragraph(demonstration.diagnosis.headline)
    console.say("4. Add it", style="bold")
    printing.before_after(
        before, demonstration.after, units, "motion that neither has seen"
    )
    console.say(f"Hidden was: {demonstration.truth}.")
    console.written(out / "report.html", "open it in a browser")
    runs = [out / name for name in RUNS]
    console.next_step(
        ["compare", out / "model.json", out / "better.json", "--data", runs[-1]]
    )
