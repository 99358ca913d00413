"""The sections of the report about what can be relied on: certificate, data check, provenance."""

from __future__ import annotations

from html import escape

from sdp_vs_penalty.report.section import Material, Section, number, table, text


def certificate(material: Material) -> Section:
    """Computed by this program, whoever solved the problem."""
    families = sorted({f for e in material.models.values() for f in e.certificate.violations})
    rows: list[list[object]] = [
        [
            f"worst violation: {family}",
            *(_violation(e.certificate.violations.get(family)) for e in _all(material)),
        ]
        for family in families
    ]
    rows += [
        [
            "loss (sum of squared weighted errors)",
            *(number(e.certificate.loss, 6) for e in _all(material)),
        ],
        [
            "objective (the loss and, where the method has one, its regulariser)",
            *(number(e.certificate.upper, 6) for e in _all(material)),
        ],
        [
            "certified lower bound of the objective",
            *(number(e.certificate.lower, 6) for e in _all(material)),
        ],
        [
            "objective above its bound, relative to the loss",
            *(number(e.certificate.gap, 2) for e in _all(material)),
        ],
        [
            "poses with positive definite M(q)",
            *(
                "-"
                if (share := e.certificate.positive_mass_matrices) is None
                else "all (follows from the links)"
                if e.certificate.at_every_pose
                else f"{100.0 * share:.4g} %"
                for e in _all(material)
            ),
        ],
    ]
    body = text(
        "Violations of every family of constraints, including those that a method did not receive. "
        "The lower bound is computed here from dual multipliers, independently of what a solver "
        "claims."
    )
    body += table(["figure", *material.models], rows)
    for name, e in material.models.items():
        if e.certificate.held:
            held = ", ".join(e.certificate.held)
            body += text(f"{name}: objective and gap are of the added effects, with {held} held fixed.")
    return Section("certificate", "Certificate", body)


def _all(material: Material) -> list:  # type: ignore[type-arg]
    return list(material.models.values())


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
