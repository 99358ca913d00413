"""Contracts that plug-ins keep, for the tests of their own packages."""

from collections.abc import Callable
from functools import partial
from typing import Any

from sdp_vs_penalty.api.registration import registry_of
from sdp_vs_penalty.data.formats import FORMATS
from sdp_vs_penalty.effects import EFFECTS
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import ESTIMATORS
from sdp_vs_penalty.solvers import SOLVERS
from sdp_vs_penalty.testing.demand import ContractError as ContractError


def contracts(plugin: Any) -> dict[str, Callable[[], None]]:
    """Return what a plug-in has to keep: functions that raise ContractError with a
    sentence, by their names.

    Parameters
    ----------
    plugin : type or module
        A subclass of Effect, Estimator or Solver, or a module that is a format of
        measurements or of export. It has to be registered, or named as an entry point.

    Returns
    -------
    dict
        Contracts by name, each without arguments.

    Raises
    ------
    InputError
        For what is no plug-in, and for one that is not registered.

    Examples
    --------
    In a test of the plug-in's package::

        @pytest.mark.parametrize("name", contracts(BumpStop))
        def test_it_keeps_the_contracts(name):
            contracts(BumpStop)[name]()
    """
    registry = registry_of(plugin)
    if not registry.has(plugin):
        raise InputError(
            f"{registry.kind} {registry.name_of(plugin)} is not registered",
            "name it as an entry point, or call sdp_vs_penalty.register",
        )
    asked: tuple[Callable[..., None], ...]
    subject: tuple[Any, ...]
    if registry is EFFECTS:
        from sdp_vs_penalty.testing import effect_contract

        variants = partial(effect_contract.variants, plugin)
        asked, subject = effect_contract.CONTRACTS, (plugin, variants)
    elif registry in (ESTIMATORS, SOLVERS):
        from sdp_vs_penalty.testing import methods

        is_solver = registry is SOLVERS
        asked = methods.SOLVER_CONTRACTS if is_solver else methods.ESTIMATOR_CONTRACTS
        subject = (plugin(),)
    else:
        from sdp_vs_penalty.testing import files

        is_format = registry is FORMATS
        asked = files.FORMAT_CONTRACTS if is_format else files.EXPORT_CONTRACTS
        subject = (plugin,)
    return {contract.__name__: partial(contract, *subject) for contract in asked}
