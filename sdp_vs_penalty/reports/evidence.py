"""The sections of the report about what can be relied on: certificate, data check, provenance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape

from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.reports.section import Material, Section, number, table, text


def certificate_rows(estimates: Sequence[Estimate]) -> list[list[str]]:
    """What is certified of each: violations of every family of constraints, loss, objective, its bound
    and their gap, mass matrices; the name first."""
    found = [e.certificate for e in estimates]
    families = sorted({f for c in found for f in c.violations})
    rows = [
        [f"worst violation: {f}", *(_violation(c.violations.get(f)) for c in found)] for f in families
    ]
    figures: tuple[tuple[str, Callable[[Certificate], str]], ...] = (
        ("loss (sum of squared weighted errors)", lambda c: number(c.loss, 6)),
        (
            "objective (the loss and, where the method has one, its regulariser)",
            lambda c: number(c.upper, 6),
        ),
        ("certified lower bound of the objective", lambda c: number(c.lower, 6)),
        ("objective above its bound, relative to the loss", lambda c: number(c.gap, 2)),
        ("poses with positive definite M(q)", _poses),
    )
    return rows + [[name, *map(said, found)] for name, said in figures]


def _poses(c: Certificate) -> str:
    share = c.positive_mass_matrices
    if share is None:
        return "-"
    return "all (follows from the links)" if c.at_every_pose else f"{100.0 * share:.4g} %"


#: What the certificate says, and who computed it.
CERTIFICATE = (
    "Violations of every family of constraints, including those that a method did not receive. The "
    "lower bound is computed here from dual multipliers, independently of what a solver claims."
)


def certificate(material: Material) -> Section:
    """Computed by this program, whoever solved the problem."""
    body = text(CERTIFICATE)
    body += table(["figure", *material.models], certificate_rows(list(material.models.values())))
    for name, e in material.models.items():
        if e.certificate.held:
            held = ", ".join(e.certificate.held)
            body += text(f"{name}: objective and gap are of the added effects, with {held} held fixed.")
    return Section("certificate", "Certificate", body)


def _violation(value: float | None) -> str:
    return "-" if value is None else ("0" if value == 0.0 else f"{value:.2g}")


def data_check(material: Material) -> Section:
    """What `sdp-vs-penalty check` says of the runs."""
    parts = []
    for report in material.checks:
        problems = report.problems
        parts.append(f"<h3>{escape(report.run)}</h3>")
        if not problems:
            parts.append(text("No problems found."))
        for f in report.issues:
            parts.append(
                f'<div class="finding {escape(f.severity)}"><b>{escape(f.kind)}</b> '
                f"({escape(f.where)}): {escape(f.what)} <span>How sure: {escape(f.certainty)}. "
                f"What to do: {escape(f.remedy)}.</span></div>"
            )
    return Section("data", "Data check", "".join(parts))


def provenance(material: Material) -> Section:
    """Versions, settings, hashes, and the commands."""
    rows = []
    for name, e in material.models.items():
        versions = ", ".join(f"{k} {v}" for k, v in e.provenance.get("versions", {}).items())
        settings = ", ".join(f"{k}={v}" for k, v in e.settings.items())
        effects = ", ".join(effect.brief for effect in e.model.effects)
        p = e.preprocessing
        filters = f"states {number(p.state_cutoff)} Hz, torque {number(p.torque_cutoff)} Hz"
        for what, value in (
            ("method", f"{e.method} ({settings})"),
            ("effects", effects),
            ("filters", filters),
            ("runs", ", ".join(map(str, e.provenance.get("runs", [])))),
            ("data hash", e.provenance.get("data_hash", "")),
            ("seed", e.provenance.get("seed", "")),
            ("versions", versions),
        ):
            rows.append((name, what, value))
    body = table(("model", "what", "which"), rows, numbers_from=3)
    if material.commands:
        body += f"<pre tabindex=0>{escape(chr(10).join(material.commands))}</pre>"
    return Section("provenance", "Provenance", body)
