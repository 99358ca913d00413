"""Who takes part: every conic solver of the library, our default path, and what users do without one."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

from sdp_vs_penalty.errors import InputError, unknown
from sdp_vs_penalty.estimators.estimator import Fit
from sdp_vs_penalty.estimators.lmi_sdp import solve_sdp
from sdp_vs_penalty.shootout.contestant import DEFAULT_ACCURACY, Applies, Contestant, with_proof
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer, dimacs_error
from sdp_vs_penalty.shootout.rivals import rivals
from sdp_vs_penalty.solvers import absent, solver_modules, version, warm_up
from sdp_vs_penalty.version import __version__

#: What our loop asks of a solver, unless its file names a FINEST of its own.
_FINEST = 1e-10


def contestants() -> dict[str, Contestant]:
    """All of them by name, absent ones included."""
    modules = solver_modules()
    found = [_conic(name, module) for name, module in modules.items()]
    found += [_defaults(name, m) for name, m in modules.items() if hasattr(m, "DEFAULT_ACCURACY")]
    found += [_certified(name, m) for name, m in modules.items()]
    return {c.name: c for c in sorted((*found, *rivals()), key=lambda c: c.name)}


def chosen(names: list[str] | None) -> tuple[list[Contestant], list[Contestant]]:
    """The contestants of these names (default: all), those that are here and those that are absent.

    Raises InputError for a name that does not exist, and for one asked for by name that is absent.
    """
    everyone = contestants()
    if names is None:
        return [c for c in everyone.values() if not c.absent], [c for c in everyone.values() if c.absent]
    for name in names:
        if name not in everyone:
            raise unknown("solver", name, everyone)
        if why := everyone[name].absent:
            raise InputError(f"solver {name} cannot be used here", why)
    return [everyone[name] for name in names], []


def _takes(module: ModuleType) -> Applies:
    def applies(instance: Instance) -> str | None:
        if "exp" not in module.CONES and instance.objective.entropy is not None:
            return "no cone for log det"
        return None

    return applies


def _conic(name: str, module: ModuleType) -> Contestant:
    def solve(instance: Instance, accuracy: float | None) -> Answer:
        sdp = instance.sdp
        solution = module.solve(sdp.conic, accuracy)
        sent = zip(instance.sent, sdp.multipliers(solution), strict=True)
        multipliers = instance.all_multipliers(sent)
        seen, x, z = solution.seen or (sdp.conic, solution.x, solution.z)
        return Answer(
            sdp.theta(solution),
            solution.claims,
            solution.status,
            solution.iterations,
            solution.setup_seconds,
            solution.solve_seconds,
            multipliers,
            sdp.entropy_slopes(solution),
            dimacs_error(seen, x, z),
        )

    return Contestant(
        name,
        (module.__doc__ or "").strip().splitlines()[0],
        solve,
        _takes(module),
        lambda: version(module),
        absent(module),
        warm_up=lambda: warm_up(module),
    )


def _defaults(name: str, module: ModuleType) -> Contestant:
    """The solver told nothing: its own tolerances, which its documentation calls sensible."""
    told = _conic(name, module)
    return replace(
        told,
        name=f"{name} untuned",
        description=f"{name} with its own default settings",
        solve=lambda instance, accuracy: told.solve(instance, None),  # type: ignore[arg-type]
        tunable=False,
        promise=module.DEFAULT_ACCURACY,
    )


def _certified(name: str, module: ModuleType) -> Contestant:
    """A solver inside our loop: certified, and solved again where the gap is loose; with Clarabel it is
    the default path, ``lmi-sdp``."""
    finest = getattr(module, "FINEST", _FINEST)

    def fits(instance: Instance) -> list[Fit]:
        return [solve_sdp(instance.task, instance.objective, instance.constraints, name, finest)]

    def words(fit: Fit) -> tuple[list[str], int]:
        said = fit.details["solver_said"]
        return said, sum(int(word.rpartition("(")[2].rstrip(")")) for word in said)

    ours = name == "clarabel"
    return Contestant(
        "lmi-sdp" if ours else f"{name} certified",
        f"{name} inside our loop: scaled, certified, solved again where the gap is loose",
        lambda instance, accuracy: with_proof(instance, accuracy, fits, words),
        _takes(module),
        (lambda: __version__) if ours else lambda: version(module),
        absent(module),
        tunable=False,
        promise=max(DEFAULT_ACCURACY, 10.0 * finest),
        warm_up=lambda: warm_up(module),
    )
