"""What is certified of an estimate, as a record and in words."""

from dataclasses import dataclass, field

import numpy as np

from sdp_vs_penalty.effects.written import read_effect
from sdp_vs_penalty.estimators.lmi_sdp import FAR_GAP
from sdp_vs_penalty.records import JsonRecord, stored_as
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.constraint import BarycentricBound


@dataclass(frozen=True, repr=False)
class Certificate(Shown, JsonRecord):
    """What is verified of an estimate: violations of its constraints, and its distance
    to the optimum. A field is None where it does not apply."""

    #: Worst violation of each family of constraints, in its own units (kg, kg m, kg
    #: m^2, ...), of the whole model.
    violations: dict[str, float]
    #: Sum of squared (weighted) torque errors of the estimate.
    loss: float = np.nan
    #: Objective of the nearest feasible point towards the interior, without the held
    #: effects.
    upper: float | None = None
    #: Lower bound on the optimum of the convex problem, without the held effects.
    lower: float | None = None
    #: (upper - lower) / max(loss, 1e-12 |tau|^2) [-].
    gap: float | None = None
    #: Share of 10 000 random poses at which M(q) is positive definite.
    positive_definite_share: float | None = field(
        default=None, metadata=stored_as("positive_mass_matrices")
    )
    #: Smallest thickness of a link [m], as its inertia states it.
    smallest_thickness: float | None = None
    #: Effects that were not optimised: upper, lower and gap are of the other effects
    #: alone.
    held: list[str] = field(default_factory=list)
    #: Largest radius of gyration of a link [m].
    largest_gyration: float | None = None
    #: Largest ratio of a link's radius of gyration to the largest half axis of its
    #: body; at most 1 for what fits.
    body_share: float | None = None
    #: Least and largest mean density of the links whose geometry has a volume [kg/m^3].
    density: list[float] | None = None
    #: Whether the links' pseudo-inertias imply that M(q) is positive definite at every
    #: pose.
    at_every_pose: bool = False
    #: Hash of the parameters and bounds that it is of; "" where it is of none yet.
    certifies: str = ""

    @property
    def worst(self) -> float:
        """Largest violation of all families of constraints, each in its own unit.

        Zero says that the constraints hold. Whether links can exist is asked of the
        verdict: it refuses a link that weighs next to nothing, too.
        """
        return max(self.violations.values(), default=0.0)

    @property
    def is_undecided(self) -> bool:
        """Whether the bound cannot tell that the optimum was found: it lies far below,
        but leaves out limits that are not convex, and those hold."""
        holds = self.violations.get(BarycentricBound.family, np.inf) == 0.0
        return holds and self.gap is not None and FAR_GAP < self.gap < 1.0

    @property
    def not_found(self) -> str:
        """A sentence if the gap shows that the optimum was not found, else ""."""
        if self.gap is None or self.gap <= FAR_GAP or self.is_undecided:
            return ""
        return (
            f"The optimum was not found: the certified lower bound is {self.gap:.2g} of"
            " the loss below this objective; do not use these parameters."
        )

    def __str__(self) -> str:
        """Return the certificate in words, one line a fact."""
        families = ", ".join(
            f"{family} {value:.2g}" for family, value in self.violations.items()
        )
        # The summary begins with the worst violation and the loss.
        worst, loss, *other_lines = self.summary()
        bounds = [("objective", self.upper), ("certified lower bound", self.lower)]
        bound_lines = [(name, f"{x:.9g}") for name, x in bounds if x is not None]
        lines = [
            worst,
            ("violation by family", families or "there are no constraints"),
            loss,
            *bound_lines,
            *other_lines,
        ]
        texts = [f"  {label:22} {text}" for label, text in lines]
        return "\n".join(["certificate", *texts])

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        return "Certificate", self.summary()[:4]

    def summary(self) -> list[tuple[str, str]]:
        """Return the certificate's facts as (label, text), the most important first.

        Example: ("worst violation", "0 (every constraint holds)"). The first three are
        worst violation, loss and optimality gap; figures of the links follow if they
        are known.
        """
        loss = f"{self.loss:.6g} (sum of squared weighted torque errors)"
        if np.isnan(self.loss):
            loss = "not known: the parameters were given, and no data with them"
        facts = [
            ("worst violation", self._violations_text()),
            ("loss", loss),
            ("optimality gap", self._gap_text()),
        ]
        if self.smallest_thickness is not None:
            mm_per_m = 1e3
            thickness = f"{mm_per_m * self.smallest_thickness:.1f} mm"
            facts.append(("smallest thickness", thickness))
        if self.largest_gyration is not None and self.body_share is not None:
            fits = "at most"
            if self.body_share > 1.0:
                fits = "beyond what any mass inside can have:"
            gyration = f"{self.largest_gyration:.3g} m ({fits} {self.body_share:.2g}"
            facts.append(
                ("largest radius of gyration", f"{gyration} of a link's body)")
            )
        if self.density is not None:
            # Lowest and highest, once if both read the same.
            span = " to ".join(dict.fromkeys(f"{x:.3g}" for x in self.density))
            facts.append(("mean density", f"{span} kg/m^3 of the links' geometry"))
        if self.positive_definite_share is not None:
            share = 100.0 * self.positive_definite_share
            text = f"positive definite in {share:.4g} % of 10 000 random poses"
            if self.at_every_pose:
                text = "valid in every pose"
            facts.append(("inertia matrix", text))
        return facts

    def _violations_text(self) -> str:
        """Return the violated families of constraints as text, the worst first."""
        broken = {family: v for family, v in self.violations.items() if v > 0.0}
        if not broken:
            return "0 (every constraint holds)"
        worst = sorted(broken.items(), key=lambda item: -item[1])
        text = ", ".join(f"{family} {value:.2g}" for family, value in worst)
        if self.gap is not None and set(broken) == {BarycentricBound.family}:
            text += " (not convex, hence not imposed); every other constraint holds"
        return text

    def _gap_text(self) -> str:
        """Return the certified distance to the optimum, or why there is none.

        Names the effects that were held fixed, each once.
        """
        if np.isnan(self.loss):
            return "not known, as the loss"
        if self.gap is None:
            return "no lower bound: the method gave no multipliers of constraints"
        # Once each: a joint may have its effect with a shape constant of its own.
        kinds = dict.fromkeys(read_effect(text).name for text in self.held)
        held_words = f", with {', '.join(kinds)} held fixed" if self.held else ""
        without = (
            ", without the limits that are not convex" if self.is_undecided else ""
        )
        return (
            f"{self.gap:.1e} of the loss (certified lower bound{without}){held_words}"
        )


#: Of parameters on the way to others, which nobody is shown.
NOT_CERTIFIED = Certificate({})
